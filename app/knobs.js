// Knobs in the page: a place on a slider becomes a value here, and travels as the event `set`.  See widgets/knob.py.
(() => {
  const vi = window.vi;
  const bare = vi.send;
  if (vi.wrapped === bare) return; // installed already
  vi.wrapped = vi.send = (event) => (event.k === "knob" && vi.knob(event.key) ? undefined : bare(event));

  const rowOf = (el) => el.closest("[data-knob]");
  const STEPS = 1000;
  const REST_MS = 60; // between two values of a slider that moves

  vi.valueAt = (el) => {
    const { low, high, scale, zero, whole } = el.dataset;
    const share = el.value / STEPS;
    if (scale === "log") {
      if (zero && share === 0) return 0;
      return Number((low * (high / low) ** share).toPrecision(2));
    }
    const v = Number(low) + share * (high - low);
    return whole ? Math.round(v) : Number(v.toPrecision(3));
  };
  vi.placeOf = (el, v) => {
    const { low, high, scale } = el.dataset;
    const share = scale === "log" ? (v > low ? Math.log(v / low) / Math.log(high / low) : 0) : (v - low) / (high - low);
    return Math.round(STEPS * Math.min(1, Math.max(0, share)));
  };

  // The newest value of a knob that moves is sent at once, then at most every REST_MS, and always at the end.
  const waiting = new Map();
  let sent = 0;
  const flush = (key) => {
    if (!waiting.has(key)) return;
    vi.send({ k: "set", key, v: waiting.get(key) });
    waiting.delete(key);
    sent = performance.now();
  };
  const say = (key, v, now) => {
    const again = waiting.has(key);
    waiting.set(key, v);
    const rest = REST_MS - (performance.now() - sent);
    if (now || rest <= 0) flush(key);
    else if (!again) setTimeout(() => flush(key), rest);
  };
  const word = (v) => (v === true ? "on" : v === false ? "off" : String(v));
  const set = (row, v, now = true) => {
    const { reference } = row.dataset;
    const same = word(v) === reference || (typeof v === "number" && v === Number(reference));
    row.classList.toggle("vi-changed", !same);
    say(row.dataset.knob, v, now);
  };

  vi.slide = (el, done = false) => {
    const row = rowOf(el);
    const v = vi.valueAt(el);
    row.querySelector(".vi-num").value = String(v);
    set(row, v, done);
    if (done) el.blur(); // keys go back to stepping
  };
  vi.typed = (el) => {
    const row = rowOf(el);
    const slide = row.querySelector("[type=range]");
    const v = Number(el.value);
    if (el.value.trim() === "" || Number.isNaN(v)) {
      el.value = String(vi.valueAt(slide));
      return;
    }
    slide.value = vi.placeOf(slide, v);
    set(row, v);
  };
  vi.picked = (el) => {
    const v = el.type === "checkbox" ? el.checked : el.value;
    if (el.type === "checkbox") el.nextElementSibling.textContent = word(v);
    set(rowOf(el), v);
    el.blur();
  };
  vi.unset = (el) => {
    const row = rowOf(el);
    const { reference } = row.dataset;
    const slide = row.querySelector("[type=range]");
    if (slide) {
      slide.value = vi.placeOf(slide, Number(reference));
      row.querySelector(".vi-num").value = reference;
      return set(row, Number(reference));
    }
    const control = row.querySelector("input, select");
    if (control.type === "checkbox") control.checked = reference === "on";
    else control.value = reference;
    vi.picked(control);
  };

  // Only knobs whose name or meaning has all the words.
  vi.find = (el) => {
    const words = el.value.toLowerCase().split(/\s+/).filter(Boolean);
    const panel = el.closest(".vi");
    for (const row of panel.querySelectorAll("[data-knob]"))
      row.hidden = !words.every((w) => row.dataset.words.includes(w));
    for (const group of panel.querySelectorAll("[data-stage]")) {
      const any = group.querySelector("[data-knob]:not([hidden])");
      group.hidden = !any;
      if (words.length) group.open = !!any;
    }
  };

  // To the knob behind a gate, wherever its name was clicked; false when this layout has no knobs.
  vi.knob = (key) => {
    if (!vi.show("What-if")) return false;
    let tries = 0;
    const look = () => {
      const row = [...document.querySelectorAll("[data-knob]")].find((el) => el.dataset.knob === key);
      if (!row || row.closest(".vi").offsetParent === null) {
        if (++tries < 40) setTimeout(look, 50);
        return;
      }
      const search = row.closest(".vi").querySelector("[type=search]");
      if (search && search.value) {
        search.value = "";
        vi.find(search);
      }
      row.closest("details").open = true;
      row.scrollIntoView({ block: "center" });
      for (const other of document.querySelectorAll(".vi-focus")) other.classList.remove("vi-focus");
      row.classList.add("vi-focus");
    };
    look();
    return true;
  };
  vi.show = (title) => {
    const found = [...document.querySelectorAll("[role=tab]")].find((tab) => tab.textContent.trim() === title);
    if (!found) return false;
    const { x, y } = found.getBoundingClientRect();
    const at = { bubbles: true, isPrimary: true, pointerId: 1, button: 0, clientX: x + 5, clientY: y + 5 };
    for (const name of ["pointerdown", "pointerup"]) found.dispatchEvent(new PointerEvent(name, at)); // tabs can be dragged
    return true;
  };

  vi.load = (el) => {
    const [file] = el.files;
    el.value = "";
    if (!file) return;
    if (file.size > 65536) vi.send({ k: "load", text: "", name: file.name });
    else file.text().then((text) => vi.send({ k: "load", text, name: file.name }));
  };
})();
