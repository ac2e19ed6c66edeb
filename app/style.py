"""The style sheet of the panels, installed once when a page opens.

Class names start with `vi`.  The zoom of the camera image stands in CSS variables on the root, so that it survives new
content: `--vi-x`, `--vi-y` (px), `--vi-z`.
"""

from __future__ import annotations

from vins_core.report import MATCH_STAGES

from .palette import (
    AGE_RAMP,
    BAD,
    CANDIDATE,
    ESTIMATE,
    FORK,
    GROUND,
    IMU,
    LINE,
    MUTED,
    OK,
    PRIOR,
    RAISED,
    SELECTION,
    STRONG,
    SUNKEN,
    TEXT,
)

FONT = "Inter,-apple-system,'Segoe UI',Roboto,'Helvetica Neue','Liberation Sans',Arial,sans-serif"
MONO = "'JetBrains Mono',Menlo,Consolas,'Liberation Mono','DejaVu Sans Mono',monospace"

_BASE = f"""
:root{{--vi-x:0px;--vi-y:0px;--vi-z:1}}
.vi{{font:12px/1.4 {FONT};font-variant-numeric:tabular-nums;color:{TEXT};padding:0 14px 8px 10px;letter-spacing:0}}
.vi *,.vi-tip *{{box-sizing:border-box}}
.vi b{{color:{STRONG};font-weight:600}}
.vi svg{{display:block}}
.vi-muted{{color:{MUTED}}}
.vi-bad{{color:{BAD}}} .vi-ok{{color:{OK}}}
.vi-unit{{color:{MUTED};font-size:11px}}
.vi-link{{color:{ESTIMATE};cursor:pointer;text-decoration:none}}
.vi-link:hover{{text-decoration:underline}}
.vi-term[data-tip]{{cursor:help}}
.vi-term[data-tip]:hover{{color:{STRONG}}}
.vi-row{{display:flex;gap:6px;align-items:center;flex-wrap:wrap}}
.vi-h{{display:flex;justify-content:space-between;align-items:baseline;gap:10px;margin:14px 0 6px;font-size:11px;
 letter-spacing:.06em;text-transform:uppercase;color:{MUTED};font-weight:600}}
.vi>.vi-h:first-child{{margin-top:8px}}
.vi-note{{text-transform:none;letter-spacing:0;font-weight:400;text-align:right}}
.vi-p{{margin:4px 0 6px}}
.vi-key{{white-space:nowrap;font:600 11px/1.3 {FONT};color:{STRONG};background:{RAISED};border:1px solid #4A515C;
 border-bottom-width:2px;border-radius:4px;padding:0 5px}}
.vi-empty{{margin:6px 0;padding:12px 14px;border:1px dashed {LINE};border-radius:6px;line-height:1.55}}
.vi-empty .vi-key{{margin:0 1px}}
"""

_TABS = """
[role=tablist]:has(>[role=tab]:nth-child(5))>[role=tab]{padding:0 .7em!important}
[role=tablist]:has(>[role=tab]:nth-child(5))>[role=tab]>div:first-child:has(svg){display:none!important}
"""

_CHIPS = f"""
.vi-chip{{display:inline-flex;align-items:baseline;gap:4px;background:{RAISED};border-radius:4px;padding:1px 7px;
 white-space:nowrap;color:#C6CCD4}}
.vi-chip[data-tip]{{cursor:help}}
.vi-chip.vi-ok{{background:#143D30;color:#7FE8C0}} .vi-chip.vi-bad{{background:#4A2117;color:#FFB49E}}
.vi-chip.vi-est{{background:#14364A;color:#9DD8F7}} .vi-chip.vi-imu{{background:#44340F;color:#FFD57A}}
.vi-chip.vi-prior{{background:#38205A;color:#DDBBFF}} .vi-chip.vi-sel{{background:#3D3B18;color:{SELECTION}}}
.vi-chip.vi-ok b,.vi-chip.vi-bad b,.vi-chip.vi-est b{{color:inherit}}
"""

_TABLES = f"""
.vi-table{{border-collapse:collapse;width:100%}}
.vi-table td,.vi-table th{{padding:2px 6px;text-align:left;border-bottom:1px solid #2B3038;white-space:nowrap}}
.vi-table th{{color:{MUTED};font-weight:500;font-size:11px}}
.vi-table .vi-n{{text-align:right}} .vi-table .vi-wide{{width:42%}}
.vi-table td:first-child,.vi-table th:first-child{{padding-left:4px}}
.vi-click{{cursor:pointer}} .vi-click:hover td{{background:#2C333D}}
.vi-table tr.vi-now td{{background:#3A3A1C}} .vi-table tr.vi-dim td{{color:{MUTED}}}
.vi-facts{{display:grid;grid-template-columns:max-content 1fr;gap:2px 14px;margin:0}}
.vi-facts dt{{color:{MUTED}}} .vi-facts dd{{margin:0;color:{TEXT}}}
.vi-bar{{position:relative;height:10px;background:{SUNKEN};border-radius:3px;overflow:hidden;min-width:48px}}
.vi-bar i{{position:absolute;left:0;top:0;bottom:0;border-radius:3px}}
.vi-sigmas{{display:flex;gap:3px}} .vi-sigmas>*{{flex:1 1 0;min-width:0}}
.vi-table th .vi-sigmas{{font-size:10px;color:#7C8590}}
.vi-stack{{display:flex;height:12px;border-radius:3px;overflow:hidden;gap:1px}}
.vi-stack i{{height:100%}}
.vi-costs{{display:grid;grid-template-columns:max-content 1fr max-content;gap:4px 10px;align-items:center}}
.vi-costs .vi-n{{text-align:right}}
"""

_GATES = f"""
.vi-gates{{display:grid;grid-template-columns:14px minmax(84px,1fr) 82px minmax(112px,1.15fr);
 gap:0 9px;align-items:center;margin:2px 0 4px}}
.vi-gates>.vi-rule{{grid-column:1/-1;height:1px;background:#2B3038;margin:5px 0}}
.vi-gates .vi-val{{text-align:right;color:{STRONG};font-weight:600;white-space:nowrap}}
.vi-gates .vi-val .vi-unit{{font-weight:400}}
.vi-gates .vi-behind{{grid-column:2/4;min-width:0;display:flex}}
.vi-gates .vi-knob{{font:10.5px/1.35 {MONO};color:#7F93A8;cursor:pointer;overflow:hidden;
 text-overflow:ellipsis;white-space:nowrap;justify-self:start;max-width:100%}}
.vi-gates .vi-knob:hover{{color:{ESTIMATE};text-decoration:underline}}
.vi-gates .vi-behind{{gap:8px;align-items:baseline}}
.vi-gates+.vi-row,.vi-table+.vi-row,.vi-row+.vi-facts{{margin-top:6px}}
.vi-gates .vi-lim{{display:flex;justify-content:space-between;gap:8px;font-size:11px;color:{MUTED};white-space:nowrap}}
.vi-gates .vi-lim .vi-bad{{font-weight:600}}
.vi-meter{{position:relative;height:12px;background:{SUNKEN};border-radius:3px;overflow:hidden}}
.vi-meter i{{position:absolute;top:0;bottom:0}}
.vi-meter .vi-pass{{background:#2BC48A1F}} .vi-meter .vi-fill{{top:2px;bottom:2px;border-radius:2px}}
.vi-meter u{{position:absolute;top:0;bottom:0;width:2px;margin-left:-1px;background:{STRONG};border-radius:1px}}
.vi-meter.vi-none{{background:repeating-linear-gradient(135deg,{SUNKEN} 0 4px,{RAISED} 4px 6px)}}
.vi-lamps{{display:grid;grid-template-columns:repeat(4,1fr);gap:3px;margin:4px 0 8px}}
.vi-lamp{{display:flex;align-items:center;gap:5px;min-width:0;border-radius:4px;background:{SUNKEN};padding:4px 5px;
 font-size:11px;line-height:1.2;border-left:3px solid {CANDIDATE};color:{MUTED}}}
.vi-lamp svg{{flex:none;width:12px;height:12px}}
.vi-lamp.vi-ok{{border-left-color:{OK};color:{TEXT}}} .vi-lamp.vi-bad{{border-left-color:{BAD};color:{TEXT};
 background:#2E1D18}}
.vi-stage{{margin-top:12px;display:flex;gap:7px;align-items:baseline;flex-wrap:wrap}}
.vi-stage b{{font-size:12.5px}}
.vi-outcome{{margin:3px 0 5px;padding:5px 9px;border-left:3px solid {BAD};background:#2E1D18;border-radius:0 4px 4px 0}}
.vi-outcome.vi-good{{border-left-color:{OK};background:#15261F;color:{TEXT}}}
.vi-outcome.vi-plain{{border-left-color:{CANDIDATE};background:{SUNKEN};color:{TEXT}}}
.vi-outcome.vi-kept{{border-left-color:{ESTIMATE};background:#16242E;color:{TEXT}}}
"""

_CAMERA = f"""
.vi-img{{position:relative;overflow:hidden;border-radius:5px;background:#000;touch-action:none;margin-top:8px}}
.vi-zoom{{contain:strict;position:absolute;inset:0;transform-origin:0 0;
 transform:translate(var(--vi-x),var(--vi-y)) scale(var(--vi-z))}}
.vi-zoom img,.vi-zoom svg{{position:absolute;inset:0;width:100%;height:100%;display:block}}
:root.vi-magnified .vi-zoom img{{image-rendering:pixelated}}
.vi-zoom circle{{r:calc(var(--r,3.6px)*var(--u)/var(--vi-z));stroke-width:calc(var(--s,1.3px)*var(--u)/var(--vi-z));
 cursor:pointer}}
.vi-zoom polyline{{fill:none;stroke-width:calc(var(--s,1.1px)*var(--u)/var(--vi-z));stroke-linejoin:round;opacity:.7;
 pointer-events:none}}
.vi-zoom .x{{cursor:pointer}}
.vi-zoom g path{{transform:scale(calc(.85*var(--u)/var(--vi-z)))}}
.vi-zoom .x path{{fill:none;stroke-width:1.8px;stroke-linecap:round}}
.vi-zoom .x .h{{stroke:#000;stroke-opacity:.6;stroke-width:4px}}
.vi-zoom .x:hover path:not(.h){{stroke:{SELECTION}}}
.vi-zoom .o{{cursor:pointer;stroke-width:.8px;stroke:#000}}
.vi-zoom circle:hover,.vi-zoom .o:hover{{stroke:{SELECTION};--s:2.4px}}
.vi-zoom .w{{--r:6px;--s:1.8px}}
.vi-zoom .p{{--r:6.5px;--s:2.3px;stroke:{SELECTION};fill:#F0E44240}}
.vi-depthplot{{display:block;width:100%;height:auto;margin-top:6px;background:{SUNKEN};border-radius:5px;
  font:10px system-ui,sans-serif}}
.vi-noimg{{position:absolute;inset:0;display:flex;align-items:center;justify-content:center;padding:20px;
 text-align:center;color:{MUTED};pointer-events:none}}
.vi-scale{{display:inline-flex;align-items:center;gap:5px}}
.vi-ages{{display:inline-block;width:84px;height:9px;border-radius:4px;background:linear-gradient(90deg,{",".join(AGE_RAMP[::4])})}}
.vi-legend{{display:flex;gap:4px 12px;align-items:center;flex-wrap:wrap;margin-top:6px}}
.vi-legend+.vi-row{{margin-top:4px}}
.vi-legend span{{white-space:nowrap}}
.vi-legend svg{{display:inline-block;vertical-align:-1.5px;margin-right:4px}}
"""

_PLOTS = f"""
.vi-lane{{position:relative;cursor:pointer;touch-action:none;contain:content;flex:1 1 auto;min-width:0}}
.vi-head{{position:absolute;top:0;bottom:0;width:2px;margin-left:-1px;background:{SELECTION};pointer-events:none}}
.vi-plots{{display:flex;padding-bottom:0}}
.vi-strip{{position:relative;background:{SUNKEN};border-radius:4px;overflow:hidden}}
.vi-strip svg{{width:100%;height:100%}}
.vi-names{{flex:0 0 72px}}
.vi-name{{display:flex;flex-direction:column;justify-content:center;line-height:1.25;font-size:11.5px;white-space:nowrap}}
.vi-max{{font-size:10px;color:#7C8590}}
.vi-values{{flex:0 0 78px}}
.vi-value{{display:flex;flex-direction:column;justify-content:center;align-items:flex-end;line-height:1.2;
 color:{STRONG};font-weight:600;font-size:13px;white-space:nowrap}}
.vi-value .vi-unit{{font-weight:400;font-size:10.5px}}
.vi-over{{position:relative;height:0}}
.vi-tight{{padding-top:0;padding-bottom:0}}
.vi-tight .vi-values{{position:absolute;right:0;width:78px}}
.vi-grow{{flex:1 1 auto;min-width:0}}
.vi-sunken{{background:{SUNKEN};border-radius:4px;overflow:hidden}}
.vi-clock{{position:relative;height:14px;font-size:10px;color:{MUTED}}}
.vi-clock span{{position:absolute;top:2px;transform:translateX(-50%);white-space:nowrap}}
.vi-clock span:first-child{{transform:none}}
.vi-keys{{color:{MUTED};margin-left:auto;text-align:right}}
.vi-kf{{color:{ESTIMATE}}}
.vi-time{{display:flex;gap:8px;align-items:stretch}}
.vi-lanes{{position:relative;flex:0 0 58px}}
.vi-lanes span{{position:absolute;right:0;font-size:10px;line-height:10px;color:{MUTED};text-align:right}}
.vi-obs{{display:flex;align-items:flex-end;gap:2px;height:44px;padding:0 4px;background:{SUNKEN};border-radius:4px;
 position:relative;overflow:hidden}}
.vi-obs i{{flex:1 1 0;max-width:18px;min-width:2px;border-radius:2px 2px 0 0;cursor:pointer}}
.vi-obs i:hover{{background:{SELECTION}!important}}
.vi-obs u{{position:absolute;left:0;right:0;border-top:1px dashed #B9C0CA;pointer-events:none}}
"""

_TIPS = f"""
.vi-tip{{position:fixed;z-index:10000;max-width:360px;padding:9px 12px;border-radius:6px;background:#0E1013;
 border:1px solid #454C57;box-shadow:0 6px 24px #000A;color:{TEXT};font:12px/1.45 {FONT};pointer-events:none}}
.vi-tip b{{display:block;color:{STRONG};font-weight:600;margin-bottom:3px}}
.vi-tip code{{display:block;margin:5px 0;padding:4px 7px;background:{GROUND};border-radius:4px;color:#F3E9C6;
 font:11.5px/1.5 {MONO};white-space:pre-wrap}}
.vi-tip dl{{display:grid;grid-template-columns:max-content 1fr;gap:1px 10px;margin:5px 0 0;font-size:11px}}
.vi-tip dt{{color:{MUTED}}} .vi-tip dd{{margin:0}}
"""

_KNOBS = f"""
.vi-button,.vi select,.vi input[type=text],.vi input[type=search]{{font:12px/1.3 {FONT};color:{TEXT};
 background:{RAISED};border:1px solid #454C57;border-radius:4px;padding:3px 8px;height:25px}}
.vi-button{{cursor:pointer;white-space:nowrap;display:inline-flex;align-items:center;gap:4px}}
.vi-button:hover{{background:#3B424C;color:{STRONG}}} .vi-button:disabled{{opacity:.5;cursor:default}}
.vi-button.vi-go{{background:#7A2E63;border-color:{FORK};color:{STRONG}}} .vi-button.vi-go:hover{{background:#94387A}}
.vi-button input[type=file]{{display:none}}
.vi select{{padding:2px 4px}}
.vi input:focus-visible,.vi select:focus-visible,.vi-button:focus-visible{{outline:2px solid {ESTIMATE}}}
.vi-find{{display:flex;gap:5px;margin:8px 0 5px}} .vi-find input[type=search]{{flex:1 1 auto;min-width:0;cursor:text}}
.vi-knobs{{max-height:max(150px,32vh);overflow-y:auto;border:1px solid {LINE};border-radius:5px;background:{SUNKEN};
 scrollbar-width:thin;scrollbar-color:#4A515C transparent}}
.vi-stageknobs summary{{position:sticky;top:0;z-index:1;display:flex;justify-content:space-between;cursor:pointer;
 padding:4px 10px;background:#22262D;border-bottom:1px solid #2B3038;list-style:none}}
.vi-stageknobs summary::before{{content:"▸";margin-right:7px;color:{MUTED}}}
.vi-stageknobs[open]>summary::before{{content:"▾"}}
.vi-stageknobs summary b{{flex:1}}
.vi-knobrow{{display:grid;grid-template-columns:minmax(0,1.45fr) minmax(60px,1fr) 54px 32px 16px;gap:0 6px;
 align-items:center;padding:2px 6px 2px 10px;min-height:25px;border-left:2px solid transparent}}
.vi-knobrow[hidden]{{display:none}}
.vi-kname{{overflow:hidden;text-overflow:ellipsis;white-space:nowrap}}
.vi-kunit{{overflow:hidden;white-space:nowrap}}
.vi-knobrow>.vi-switch,.vi-knobrow>select{{grid-column:2/4;justify-self:start}}
.vi input.vi-num{{width:54px;height:20px;padding:0 5px;text-align:right;font-variant-numeric:tabular-nums}}
.vi input[type=range]{{width:100%;margin:0;height:16px;accent-color:{ESTIMATE};cursor:pointer}}
.vi input[type=checkbox]{{accent-color:{ESTIMATE};margin:0 4px 0 0;vertical-align:-2px;cursor:pointer}}
.vi-layers{{display:grid;gap:5px;margin-top:10px}} .vi-layers .vi-switch{{display:flex;gap:8px;align-items:center}}
.vi-layers .vi-switch>span:nth-child(2){{width:14px;text-align:center}}
.vi-switch{{cursor:pointer;white-space:nowrap}}
.vi-undo{{visibility:hidden;border:0;background:none;color:{MUTED};cursor:pointer;padding:0;font-size:14px}}
.vi-changed{{border-left-color:{FORK};background:#2A1F29}} .vi-changed .vi-kname{{color:{STRONG};font-weight:600}}
.vi-changed .vi-undo{{visibility:visible}} .vi-changed .vi-undo:hover{{color:{STRONG}}}
.vi-changed input{{accent-color:{FORK}!important}}
.vi-focus{{outline:1px solid {SELECTION};outline-offset:-1px}}
.vi-chip.vi-fork{{background:#40203A;color:#F0B8DC}} .vi-chip.vi-fork .vi-link{{color:#F0B8DC}}
.vi-forkrow{{display:flex;gap:6px;margin:8px 0 2px}}
.vi-flips{{margin:3px 0 8px}} .vi-flip{{display:flex;justify-content:space-between;gap:10px;margin-bottom:2px}}
.vi-flips .vi-lane{{height:14px}} .vi-small{{font-size:11px;line-height:1.5}}
.vi-outcome.vi-forked{{border-left-color:{FORK};background:#2A1F29;color:{TEXT}}}
.vi-p .vi-table,.vi-costs+.vi-table{{margin-top:5px}}
"""

_RUNS = f"""
.vi-run{{padding:5px 8px;margin:5px 0;border-radius:5px;background:{SUNKEN};border:1px solid {LINE}}}
.vi-run.vi-child{{margin-left:14px}}
.vi-runhead{{display:flex;gap:4px;align-items:center}}
.vi-runhead .vi-button{{height:22px;padding:1px 6px}}
.vi input.vi-runname{{flex:1 1 auto;min-width:0;height:22px;border-color:transparent;background:none;font-weight:600;
 color:{STRONG};padding:1px 4px}}
.vi input.vi-runname:hover,.vi input.vi-runname:focus{{border-color:#454C57;background:{RAISED}}}
.vi-side{{flex:none;width:16px;text-align:center;font-weight:700;border-radius:3px}}
.vi-side.vi-a{{background:{ESTIMATE};color:#10222D}} .vi-side.vi-b{{background:{FORK};color:#2A0F22}}
.vi-growing{{display:flex;gap:8px;align-items:center;margin:4px 0}} .vi-growing .vi-bar{{flex:1}}
.vi-outcome .vi-runhead{{margin-top:5px}}
.vi-value .vi-otherval{{color:{FORK};font-size:11px}}
"""

_MATRIX = f"""
.vi-matrix{{display:grid;grid-template:16px auto/26px auto;max-width:560px}}
.vi-mtop{{grid-area:1/2;position:relative}} .vi-mleft{{grid-area:2/1;position:relative}}
.vi-mtop span,.vi-mleft span{{position:absolute;font-size:10px;line-height:1;color:{MUTED};white-space:nowrap}}
.vi-mtop span{{transform:translateX(-50%);bottom:4px}} .vi-mleft span{{transform:translateY(-50%);right:5px}}
.vi-mbody{{grid-area:2/2;position:relative;aspect-ratio:1;border-radius:3px;overflow:hidden;background:#000}}
.vi-mbody img,.vi-mbody svg{{position:absolute;inset:0;width:100%;height:100%}}
.vi-mbody img{{image-rendering:pixelated}}
.vi-sides{{display:flex;gap:4px;align-items:center;margin:0 0 6px}}
.vi-sides .vi-muted{{margin-left:6px;font-size:11px}}
.vi-button.vi-on{{background:#38205A;border-color:{PRIOR};color:{STRONG}}}
.vi-edges{{stroke:#FFFFFF;stroke-opacity:.16;stroke-width:1;vector-effect:non-scaling-stroke;fill:none}}
.vi-cut{{stroke:{BAD};stroke-width:1.6;vector-effect:non-scaling-stroke;fill:none}}
.vi-cell{{fill:transparent;cursor:pointer}} .vi-cell:hover{{fill:#FFFFFF2E}}
.vi-mscale{{display:inline-flex;align-items:center;gap:4px;margin-left:8px;font-size:10px}}
.vi-magma{{display:inline-block;width:60px;height:8px;border-radius:3px;background:linear-gradient(90deg,#000004,#3B0F70,
 #8C2981,#DE4968,#FE9F6D,#FCFDBF)}}
"""

_LOOPS = f"""
.vi-funnel{{display:grid;gap:1px}}
.vi-funnelrow{{display:grid;grid-template-columns:76px 1fr 112px;gap:8px;align-items:center;line-height:15px}}
.vi-funnelbars{{display:flex;flex-direction:column;gap:1px}}
.vi-funnelbars>div{{height:10px;border-radius:3px;overflow:hidden;min-width:1px}}
.vi-funnelbars>div+div{{height:4px}} .vi-funnelbars>div:not(:only-child):first-child{{height:7px}}
.vi-funnelbars i{{float:right;height:100%;background:repeating-linear-gradient(135deg,{BAD} 0 2px,transparent 2px 5px)}}
.vi-funnelrow .vi-val{{display:flex;justify-content:space-between;gap:6px;white-space:nowrap}}
.vi-places{{font-size:11px}}
.vi-gatelines{{margin:4px 0}}
.vi-gateline{{display:grid;grid-template-columns:14px minmax(96px,1.1fr) 74px minmax(70px,1fr) 84px;gap:0 8px;
 align-items:center;border-bottom:1px solid #2B3038;min-height:19px}}
.vi-gateline:last-child{{border:0}} .vi-gateline svg{{display:block}}
.vi-gateline .vi-val{{text-align:right;color:{STRONG};font-weight:600;white-space:nowrap}}
.vi-gateline .vi-val .vi-unit{{font-weight:400}}
.vi-gateline .vi-meter{{height:10px}} .vi-gateline>span:last-child{{font-size:11px;color:{MUTED};white-space:nowrap}}
.vi-gateline .vi-knob{{cursor:pointer;border-bottom:1px dotted {MUTED}}} .vi-gateline .vi-knob:hover{{color:{ESTIMATE}}}
.vi-gateline.vi-failed{{background:#2E1D18}} .vi-gateline.vi-aside{{opacity:.55}}
.vi-outcome.vi-remedy{{border-left-color:{SELECTION};background:#2B2A17;color:{TEXT}}}
.vi-remedy b{{color:{SELECTION}}} .vi-remedy .vi-button{{height:20px;padding:0 6px;margin-left:4px}}
.vi-ask{{display:flex;gap:6px;align-items:center;margin:7px 0 0;white-space:nowrap;overflow:hidden}}
.vi input[type=number]{{font:12px/1.3 {FONT};color:{TEXT};background:{RAISED};border:1px solid #454C57;
 border-radius:4px;appearance:textfield}}
.vi .vi-ask input.vi-num{{width:62px;height:23px}} .vi-ask .vi-button{{height:23px}}
.vi-loopknobs{{max-height:32vh;margin-top:8px}} .vi-loopknobs summary{{border:0}}
.vi-listed .vi-wrong .vi-link{{color:{BAD}}} .vi-forked{{color:{FORK}}}
.vi-tabs{{display:inline-flex;gap:2px}} .vi-tab{{font:11px/1.2 {FONT};color:{TEXT};background:none;border:0;
 border-radius:4px;padding:2px 6px;cursor:pointer}} .vi-tab:hover{{background:{RAISED}}}
.vi-tab.vi-on{{background:#14364A;color:{STRONG}}}
.vi-errors{{display:grid;grid-template-columns:max-content 1fr max-content;gap:2px 10px;align-items:center}}
.vi-weight{{display:grid;grid-template-columns:1fr 30px;gap:6px;align-items:center}}
.vi-weight .vi-bar{{min-width:30px}}
.vi-candidates .vi-chip{{padding:0 6px}}
.vi-both img{{inset:auto;left:0;right:0}}
.vi-corner{{position:absolute;left:6px;margin-top:6px;padding:1px 7px;z-index:1;pointer-events:none;border-radius:4px;
 background:#0E1013CC;transform-origin:0 0;transform:scale(calc(1/var(--vi-z)))}}
.vi-zoom .vi-match{{cursor:help}} .vi-match .l{{opacity:.8;--s:1.3px;pointer-events:stroke}}
.vi-match circle{{--r:2.8px;--s:1px}} .vi-match .e,.vi-match .r,.vi-loose .l{{display:none}}
.vi-match:hover .e,.vi-match:hover .r,.vi-loose:hover .l{{display:inline}}
.vi-match:hover{{stroke:{SELECTION}}} .vi-match:hover .l{{--s:2.4px;opacity:1}}
svg:has(>.vi-match:hover)>.vi-match:not(:hover){{opacity:.25}}
.vi-match.vi-picked .l,.vi-match.vi-picked .e,.vi-match.vi-picked .r{{display:inline}}
.vi-zoom [data-pair]{{cursor:pointer}} .vi-steps td{{white-space:nowrap}}
.vi-steps svg{{display:inline-block;vertical-align:-1.5px}} .vi-match.vi-picked circle{{--r:5px}}
.vi-match .e{{stroke:{SELECTION};stroke-dasharray:4 3;--s:1.6px;opacity:1}}
.vi-match .r{{stroke:#FFFFFF;fill:none;--r:5px;--s:1.6px;opacity:1}}
.vi-fate{{cursor:pointer}} .vi-fate:hover{{color:{STRONG}}}
"""
_MAP = f"""
:root{{--vi-map-x:0px;--vi-map-y:0px;--vi-map-z:1}}
.vi-map{{--vi-x:var(--vi-map-x);--vi-y:var(--vi-map-y);--vi-z:var(--vi-map-z);background:{SUNKEN}}}
.vi-map .vi-line{{fill:none;stroke-width:calc(.6px*var(--u)/var(--vi-z))}}
.vi-map polyline{{stroke-linecap:round}}
.vi-map .vi-sigma{{fill:none;stroke-width:calc(.9px*var(--u)/var(--vi-z));opacity:.55;pointer-events:none}}
.vi-map .vi-picked{{opacity:1;fill:{SELECTION};fill-opacity:.1}}
.vi-map .vi-fix{{cursor:pointer}} .vi-map .vi-fix:hover path{{stroke:{SELECTION};stroke-width:2.4}}
.vi-map .vi-later{{opacity:.22}}
.vi-map .p{{pointer-events:none}}
.vi-map .vi-body{{--r:5px;--s:2.4px;fill:{ESTIMATE};stroke:{STRONG};cursor:help}}
.vi-north,.vi-mapscale{{position:absolute;font-size:10.5px;color:{MUTED};pointer-events:none}}
.vi-north{{right:8px;top:6px}}
.vi-mapscale{{left:8px;bottom:5px}}
.vi-yaw{{display:grid;grid-template-columns:1fr 44px;gap:6px}}
.vi-triple{{display:grid;grid-template-columns:1fr 1fr 1fr 44px;gap:6px}} .vi-triple>div{{position:relative}}
.vi-axis{{position:absolute;left:4px;top:1px;font-size:10px;color:{MUTED};pointer-events:none}}
.vi-ends{{display:flex;flex-direction:column;justify-content:space-between;font-size:11px;text-align:right}}
"""
_FATES = "".join(
    f":root.vi-hide-{k} .vi-match-{k}{{display:none}}:root.vi-hide-{k} .vi-fate-{k}{{opacity:.4}}"
    for k in range(len(MATCH_STAGES))
)

FACTOR_COLOURS = {"visual": ESTIMATE, "IMU": IMU, "prior": PRIOR, "depth": OK}
"""Colours of the three factor types, wherever a cost is split."""

CSS = "".join(
    (_BASE, _TABS, _CHIPS, _TABLES, _GATES, _CAMERA, _PLOTS, _KNOBS, _RUNS, _MATRIX, _LOOPS, _MAP, _FATES, _TIPS)
)
