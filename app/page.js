// The page's half of the interface: sends events to the session, takes the arrow keys, zooms images, and says which
// panels can be seen.  One object, `vi`; a page that reconnects gets a new bridge and keeps the rest.
(() => {
  const vi = (window.vi = window.vi || { sent: 0, x: 0, y: 0, z: 1 });
  if (vi.bridge === __BRIDGE__) return;
  vi.bridge = __BRIDGE__;

  let style = document.getElementById("vi-css");
  if (!style) {
    style = Object.assign(document.createElement("style"), { id: "vi-css" });
    document.head.append(style);
  }
  style.textContent = __CSS__;
  vi.tips = __TIPS__;

  // viser has no public way for html to call the server, so events travel as the value of a hidden text input.
  vi.send = (event) => {
    const link = window.__viserMutable;
    if (!link || !link.sendMessage) return;
    const value = JSON.stringify({ ...event, n: ++vi.sent });
    link.sendMessage({ type: "GuiUpdateMessage", uuid: vi.bridge, updates: { value } });
  };

  // Of many events the first is sent at once, then the newest every `rest` ms; the last one always is.
  vi.paced = (rest) => {
    let [newest, sent, timer] = [null, 0, 0];
    const send = () => {
      timer = 0;
      sent = performance.now();
      vi.send(newest);
    };
    return (event) => {
      newest = event;
      if (timer) return;
      const wait = sent + rest - performance.now();
      if (wait > 0) timer = setTimeout(send, wait);
      else send();
    };
  };
  const seek = vi.paced(33);
  vi.scrub = (e, el) => {
    if (e.type === "pointerdown") el.setPointerCapture(e.pointerId);
    else if (!(e.buttons & 1)) return;
    const box = el.getBoundingClientRect();
    seek({ k: "seek", f: Math.min(1, Math.max(0, (e.clientX - box.left) / box.width)) });
  };

  // The address names the view: it is asked for when a page opens, and follows it afterwards.  Ids, never paths.
  vi.asks = () => {
    const asked = new URLSearchParams(location.search);
    const event = { k: "link" };
    for (const name of ["run", "layout"]) if (asked.get(name)) event[name] = asked.get(name);
    if (/^\d{1,9}$/.test(asked.get("frame") ?? "")) event.frame = Number(asked.get("frame"));
    if (Object.keys(event).length > 1) vi.send(event);
  };
  vi.address = () => {
    const link = document.querySelector("[data-link]")?.dataset.link;
    if (!link || link === vi.linked) return;
    vi.linked = link;
    const url = new window.URL(location.href);
    for (const [name, value] of new URLSearchParams(link)) url.searchParams.set(name, value);
    history.replaceState(history.state, "", url);
  };

  // Zoom and pan live in CSS variables, so that they survive new html.  Images share theirs; an element with
  // data-zoom="map" has its own, in --vi-map-x and so on.
  vi.zooms = vi.zooms || { "": vi };
  vi.zoomOf = (el) => (vi.zooms[el?.dataset.zoom ?? ""] ??= { x: 0, y: 0, z: 1 });
  vi.place = (box, el) => {
    const [at, name] = [vi.zoomOf(el), el?.dataset.zoom ? `--vi-${el.dataset.zoom}` : "--vi"];
    const keep = (v, size) => Math.min(0, Math.max(size * (1 - at.z), v));
    at.x = keep(at.x, box.width);
    at.y = keep(at.y, box.height);
    const root = document.documentElement.style;
    root.setProperty(`${name}-x`, at.x + "px");
    root.setProperty(`${name}-y`, at.y + "px");
    root.setProperty(`${name}-z`, at.z);
    document.documentElement.classList.toggle("vi-magnified", vi.z > 2.5);
  };
  vi.wheel = (e, el) => {
    e.preventDefault();
    const [box, at] = [el.getBoundingClientRect(), vi.zoomOf(el)];
    const z = Math.min(12, Math.max(1, at.z * Math.exp(-e.deltaY * 0.0016)));
    const pointer = [e.clientX - box.left, e.clientY - box.top];
    at.x = pointer[0] - ((pointer[0] - at.x) * z) / at.z;
    at.y = pointer[1] - ((pointer[1] - at.y) * z) / at.z;
    at.z = z;
    vi.place(box, el);
  };
  vi.pan = (e) => {
    const [el, at] = [e.currentTarget, vi.zoomOf(e.currentTarget)];
    if (!(e.buttons & 1) || at.z === 1) return;
    at.x += e.movementX;
    at.y += e.movementY;
    vi.place(el.getBoundingClientRect(), el);
  };
  vi.reset = (el) => {
    vi.zoomOf(el).z = 1;
    vi.place({ width: 0, height: 0 }, el);
  };

  // Only what can be seen is rendered; only the page knows what that is, and how wide the 3D view is.
  vi.reported = "";
  vi.report = () => {
    vi.address();
    const seen = [...document.querySelectorAll("[data-vip]")].filter((el) => el.offsetParent !== null);
    const panels = [...new Set(seen.map((el) => el.dataset.vip))].sort();
    const canvas = document.querySelector("canvas");
    const width = canvas ? Math.round(canvas.parentElement.getBoundingClientRect().width) : 0;
    const event = { k: "page", panels, width: window.innerWidth, height: window.innerHeight, canvas: width };
    const text = JSON.stringify(event);
    if (text !== vi.reported) {
      vi.reported = text;
      vi.send(event);
    }
  };
  vi.asks();
  vi.report();

  if (vi.listening) return;
  vi.listening = true;

  // New html: playheads go to their place before it is painted, and the session is told when it is painted, so that
  // it never sends more than the page can show.  A page in the background paints nothing.
  vi.head = 0;
  vi.painting = false;
  const paint = (then) => (document.hidden ? setTimeout(then) : requestAnimationFrame(() => setTimeout(then)));
  new MutationObserver((records) => {
    const added = records.flatMap((record) => [...record.addedNodes]).filter((node) => node.nodeType === 1);
    if (!added.some((node) => node.matches(".vi") || node.querySelector(".vi"))) return;
    vi.head = added.findLast((node) => node.dataset.head)?.dataset.head ?? vi.head;
    for (const el of document.querySelectorAll(".vi-head")) el.style.left = 100 * vi.head + "%";
    if (vi.painting) return;
    vi.painting = true;
    paint(() => {
      vi.painting = false;
      vi.send({ k: "painted" });
      vi.report();
    });
  }).observe(document.body, { childList: true, subtree: true });
  let resized = 0;
  const settle = () => {
    clearTimeout(resized);
    resized = setTimeout(vi.report, 120); // windows glide to their place
  };
  new ResizeObserver(settle).observe(document.querySelector("canvas")?.parentElement ?? document.body);
  window.addEventListener("resize", settle);

  // What a name means, while the pointer rests on it.
  const tip = Object.assign(document.createElement("div"), { className: "vi-tip", hidden: true });
  document.body.append(tip);
  document.addEventListener("mouseover", (e) => {
    const el = e.target.closest?.("[data-tip]");
    const content = el && vi.tips[el.dataset.tip];
    tip.hidden = !content;
    if (!content) return;
    tip.innerHTML = content;
    const [at, own] = [el.getBoundingClientRect(), tip.getBoundingClientRect()];
    const below = at.bottom + 6 + own.height < window.innerHeight;
    tip.style.left = Math.max(6, Math.min(at.left, window.innerWidth - own.width - 6)) + "px";
    tip.style.top = (below ? at.bottom + 6 : Math.max(6, at.top - 6 - own.height)) + "px";
  });

  // In the capture phase: the 3D view and the tab strips would take the arrow keys too.
  const typing = "input:not([type=range]):not([type=checkbox]), textarea, [contenteditable=true]";
  const modal = ".mantine-Modal-content, .mantine-Spotlight-content";
  window.addEventListener(
    "keydown",
    (e) => {
      if (e.key !== "ArrowLeft" && e.key !== "ArrowRight") return;
      if (e.altKey || e.ctrlKey || e.metaKey || e.target.closest?.(typing) || document.querySelector(modal)) return;
      e.preventDefault();
      e.stopImmediatePropagation();
      vi.send({ k: "step", d: e.key === "ArrowRight" ? 1 : -1, kf: e.shiftKey });
    },
    true,
  );
  // While something is typed, too: it counts first.
  window.addEventListener(
    "keydown",
    (e) => {
      if (e.key !== "Enter" || !(e.ctrlKey || e.metaKey) || !e.target.closest?.(".vi input")) return;
      e.preventDefault();
      e.stopImmediatePropagation();
      e.target.blur();
      vi.send({ k: "fork" });
    },
    true,
  );
  // A focused tab, slider, box or button would swallow the next key.
  document.addEventListener("click", (e) => {
    if (e.target.closest("[role=tab], [role=slider], [type=checkbox], button")) document.activeElement?.blur();
    if (e.target.closest("[role=option]")) setTimeout(() => document.activeElement?.blur(), 50); // a menu takes it back
    setTimeout(vi.report, 30);
    settle();
  });
})();
