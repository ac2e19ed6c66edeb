// The page's part of loop closing: questions about two keyframes, and which fates of matches are drawn.
(() => {
  const vi = window.vi;
  vi.askPair = (el) => {
    const boxes = [...el.closest(".vi-ask").querySelectorAll("input")];
    const [i, j] = boxes.map((box) => (/^\d{1,9}$/.test(box.value) ? Number(box.value) : -1));
    if (i < 0) return boxes[0].focus();
    for (const box of boxes) box.blur();
    vi.send({ k: "pick", t: "loop", i, j });
  };
  vi.hideMatches = (fate) => document.documentElement.classList.toggle(`vi-hide-${fate}`);
})();
