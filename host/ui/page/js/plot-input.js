// @ts-check
/** Keys, wheel and drag of a plot. */

/** How much one step of zoom is. */
const ZOOM = 1.25;

/**
 * Arrows move the cursor, + and - zoom at it, page up and down pan, 0 or Home shows all.
 * @param {import("./plot.js").Plot} plot
 * @returns {() => void} ends it
 */
export function bindKeys(plot) {
  const listener = (/** @type {KeyboardEvent} */ event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (act(plot, event.key, event.shiftKey ? 10 : 1)) event.preventDefault();
  };
  plot.canvas.addEventListener("keydown", listener);
  return () => plot.canvas.removeEventListener("keydown", listener);
}

/**
 * @param {import("./plot.js").Plot} plot
 * @param {string} key
 * @param {number} step
 * @returns {boolean} whether the key is one of ours
 */
function act(plot, key, step) {
  const { from, to } = plot.seen();
  const width = to - from;
  switch (key) {
    case "ArrowLeft": moveCursor(plot, -step); return true;
    case "ArrowRight": moveCursor(plot, step); return true;
    case "+": case "=": zoomAt(plot, cursorAt(plot), 1 / ZOOM); return true;
    case "-": zoomAt(plot, cursorAt(plot), ZOOM); return true;
    case "PageUp": plot.ask({ from: from - width / 2, to: to - width / 2 }); return true;
    case "PageDown": plot.ask({ from: from + width / 2, to: to + width / 2 }); return true;
    case "0": case "Home": plot.ask(null); return true;
    default: return false;
  }
}

/**
 * @param {import("./plot.js").Plot} plot
 * @param {number} step in points
 */
function moveCursor(plot, step) {
  const u = plot.uplot;
  const x = plot.data[0];
  if (x.length === 0) return;
  const { from, to } = plot.seen();
  let index = u.cursor.idx ?? Math.floor(x.length / 2);
  index = Math.min(x.length - 1, Math.max(0, index + step));
  while (index < x.length - 1 && x[index] < from) index += 1;
  while (index > 0 && x[index] > to) index -= 1;
  u.setCursor({ left: u.valToPos(x[index], "x"), top: u.over.clientHeight / 2 });
  plot.sayCursor();
}

/** @param {import("./plot.js").Plot} plot */
function cursorAt(plot) {
  const left = plot.uplot.cursor.left;
  const { from, to } = plot.seen();
  return left !== undefined && left >= 0 ? plot.uplot.posToVal(left, "x") : (from + to) / 2;
}

/**
 * @param {import("./plot.js").Plot} plot
 * @param {number} at value of x that stays where it is
 * @param {number} factor of the width
 */
export function zoomAt(plot, at, factor) {
  const { from, to } = plot.seen();
  plot.ask({ from: at - (at - from) * factor, to: at + (to - at) * factor });
}

/**
 * The wheel zooms where the plot has the focus or Ctrl is held (else the page scrolls); drag with Shift pans, without
 * it zooms; a double click shows all.
 * @param {import("./plot.js").Plot} plot
 * @returns {() => void} ends it
 */
export function bindPointer(plot) {
  const over = plot.uplot.over;
  const wheel = (/** @type {WheelEvent} */ event) => {
    if (!event.ctrlKey && !plot.canvas.contains(document.activeElement)) return;
    event.preventDefault();
    zoomAt(plot, cursorAt(plot), event.deltaY < 0 ? 1 / ZOOM : ZOOM);
  };
  const down = (/** @type {PointerEvent} */ event) => {
    plot.canvas.focus({ preventScroll: true });
    if (event.shiftKey || event.button === 1) pan(plot, event);
  };
  const all = () => plot.ask(null);
  over.addEventListener("wheel", wheel, { passive: false });
  over.addEventListener("pointerdown", down);
  over.addEventListener("dblclick", all);
  return () => {
    over.removeEventListener("wheel", wheel);
    over.removeEventListener("pointerdown", down);
    over.removeEventListener("dblclick", all);
  };
}

/**
 * @param {import("./plot.js").Plot} plot
 * @param {PointerEvent} start
 */
function pan(plot, start) {
  const over = plot.uplot.over;
  const { from, to } = plot.seen();
  const perPixel = (to - from) / Math.max(1, over.clientWidth);
  plot.uplot.cursor.drag.x = false;
  const move = (/** @type {PointerEvent} */ event) => {
    const shift = (start.clientX - event.clientX) * perPixel;
    plot.ask({ from: from + shift, to: to + shift });
  };
  const end = () => {
    plot.uplot.cursor.drag.x = true;
    removeEventListener("pointermove", move);
    removeEventListener("pointerup", end);
    removeEventListener("pointercancel", end);
  };
  addEventListener("pointermove", move);
  addEventListener("pointerup", end);
  addEventListener("pointercancel", end);
}
