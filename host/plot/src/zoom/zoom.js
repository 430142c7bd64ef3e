// Wheel: zoom about the pointer, beside an axis that axis alone. Drag: move. Double click: the whole figure.
"use strict";
for (const panel of document.querySelectorAll("svg.panel")) {
  const data = panel.querySelector("svg"), ticks = panel.querySelector(".ticks");
  const [left, top, w, h] = ["x", "y", "width", "height"].map(name => data[name].baseVal.value);
  const [xFrom, xTo, yFrom, yTo] = panel.dataset.ends.split(" ").map(Number);
  const whole = ticks.innerHTML;
  let view = [0, 0, w, h], held = null;

  const numbers = (from, to) => {
    const least = (to - from) / 6, power = 10 ** Math.floor(Math.log10(least));
    const step = [1, 2, 5, 10].map(m => m * power).find(s => s >= least);
    const digits = Math.min(12, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
    const first = Math.ceil(from / step), count = Math.floor(to / step) - first + 1;
    return Array.from({ length: Math.min(count, 20) }, (_, k) => [(first + k) * step, ((first + k) * step).toFixed(digits)]);
  };
  const place = (e) => {
    const box = panel.getBoundingClientRect(), all = panel.viewBox.baseVal;
    return [(e.clientX - box.left) * all.width / box.width - left, (e.clientY - box.top) * all.height / box.height - top];
  };
  const show = () => {
    data.setAttribute("viewBox", view.join(" "));
    const [x, y, width, height] = view, xs = (xTo - xFrom) / w, ys = (yTo - yFrom) / h;
    if (width === w && height === h && x === 0 && y === 0) { ticks.innerHTML = whole; return; }
    const across = numbers(xFrom + x * xs, xFrom + (x + width) * xs).map(([value, text]) => {
      const at = left + ((value - xFrom) / xs - x) * w / width;
      return `<line x1="${at}" x2="${at}" y1="${top}" y2="${top + h}"/><text class="x" x="${at}" y="${top + h + 17}">${text}</text>`;
    });
    const up = numbers(yTo - (y + height) * ys, yTo - y * ys).map(([value, text]) => {
      const at = top + ((yTo - value) / ys - y) * h / height;
      return `<line x1="${left}" x2="${left + w}" y1="${at}" y2="${at}"/><text class="y" x="${left - 6}" y="${at + 4}">${text}</text>`;
    });
    ticks.innerHTML = across.concat(up).join("");
  };
  panel.addEventListener("wheel", e => {
    e.preventDefault();
    const [px, py] = place(e), by = Math.exp(Math.sign(e.deltaY) * 0.2);
    const zoom = (k, share, size) => {
      const now = Math.min(size * 4, Math.max(size * 1e-3, view[k + 2] * by));
      view[k] += share * (view[k + 2] - now);
      view[k + 2] = now;
    };
    if (px >= 0) zoom(0, px / w, w);
    if (py <= h) zoom(1, py / h, h);
    show();
  }, { passive: false });
  panel.addEventListener("pointerdown", e => { held = place(e); panel.setPointerCapture(e.pointerId); });
  panel.addEventListener("pointermove", e => {
    if (!held) return;
    const now = place(e);
    view[0] -= (now[0] - held[0]) * view[2] / w;
    view[1] -= (now[1] - held[1]) * view[3] / h;
    held = now;
    show();
  });
  for (const end of ["pointerup", "pointercancel"]) panel.addEventListener(end, () => { held = null; });
  panel.addEventListener("dblclick", () => { view = [0, 0, w, h]; show(); });
}
