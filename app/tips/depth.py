"""What the words of the depth camera mean."""

from __future__ import annotations

from collections.abc import Mapping

from vins_core.report import DepthLoss, DepthUse

from .tip import Tip

_LOSSES = {
    DepthLoss.NO_IMAGE: "No depth image came within 20 ms of this frame's.",
    DepthLoss.MISSING: "Too few of the pixels that flow sees of this track have a depth.",
    DepthLoss.NEAR: "Nearer than the calibration says that the depth camera measures.",
    DepthLoss.FAR: "Farther than the calibration says that the depth camera measures.",
    DepthLoss.EDGE: "Depths around the track differ: an edge, or a slanted surface. Flow follows something between.",
}
_USES = {
    DepthUse.FACTOR: "A residual pulls the landmark to its depth.",
    DepthUse.HELD: "The landmark stays where several frames have it; the solve does not move it.",
    DepthUse.WAITING: "The variant needs more frames with a depth before it counts.",
    DepthUse.UNSTEADY: "The frames that see it put it at different places, so its depth does not count.",
    DepthUse.GATED: "Too far from what the projections say; it counts no more.",
}

DEPTH: Mapping[str, Tip] = {
    "depth": Tip(
        "depth",
        "What the depth camera measures at the tracks of this frame, beside what the window knows of their landmarks.",
        equation="1/z = Σ |∇I_p|² / z_p  /  Σ |∇I_p|²   over the pixels that flow sees",
        unit="m",
        frame="c0, along the optical axis",
        source="seed 000.3.2; docs/depth.md",
    ),
    "depth.variant": Tip(
        "variant",
        "trust: the first depth makes the landmark. confirm: two frames must agree, their mean makes it. hold: several "
        "must agree, and their mean is not optimised.",
        source="seed 000.3.2",
    ),
    "depth.scatter": Tip(
        "measured against estimated",
        "A dot for each track of this frame whose landmark has an estimate. On the line both agree; the band is three "
        "standard deviations wide. Both axes are logarithmic.",
        unit="m",
        frame="c0",
    ),
    "depth.error": Tip(
        "relative error",
        "By how many standard deviations a measured depth is larger than the estimated one. The curve is what noise "
        "alone would make.",
        equation="(z / ẑ − 1) / σ",
        unit="sigma",
    ),
    "depth.use": Tip("use", "What the solve made of the depth at the anchor of each landmark.", source="docs/depth.md"),
    "depth.anchor": Tip(
        "at the anchor",
        "The depth that the solve uses: of the first frame of the window that sees the track, or the mean of several.",
        equation="r = (λ z − 1) / σ",
        unit="m",
        frame="c of the anchor",
        source="seed 000.3.2",
    ),
    "depth.image": Tip("depth image", "Near is bright, far is dark, and what is not coloured has no depth.", unit="m"),
    "cost.depth": Tip(
        "depth cost",
        "Robust cost of the measured depths.",
        equation="½ Σ ρ(r²),  r = (λ z − 1) / σ",
        source="seed 000.3.2",
    ),
    "gate.depth image": Tip("depth image", "Whether one came with this frame, within 20 ms."),
    "gate.nearest depth": Tip("nearest depth", "What the calibration gives as the nearest depth.", unit="m"),
    "gate.farthest depth": Tip("farthest depth", "What the calibration gives as the farthest depth.", unit="m"),
    "gate.depths agree at the anchors": Tip(
        "depths agree at the anchors", "Share of the landmarks whose depth at the anchor is within depth.max_chi2."
    ),
    "gate.depths agree in this frame": Tip(
        "depths agree in this frame", "Share of the tracks whose depth in the newest frame is within depth.max_chi2."
    ),
    **{f"depth.loss.{loss}": Tip(str(loss), why) for loss, why in _LOSSES.items()},
    **{f"depth.use.{use}": Tip(str(use), why) for use, why in _USES.items()},
}
