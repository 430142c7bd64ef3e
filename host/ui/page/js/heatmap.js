// @ts-check
/**
 * A heat map of a lookup: a grid of cells that the keyboard walks over, with the working point, its trail and the
 * controller's limits drawn over it. Higher frequencies are further up, larger currents further right; on a narrow
 * page the axes change places.
 */

import { cividis, css, diverging, inkOn, luminance, viridis } from "./colour.js";
import { h, setAttribute, setText, svg } from "./dom.js";
import { cellText, coordinate } from "./map/values.js";

/** Below this width, in CSS pixels, currents run upwards instead of to the right. */
const NARROW_PX = 620;

/**
 * What is shown; tables are [frequency][current].
 * @typedef {object} Picture
 * @property {number[]} f_sw_hz
 * @property {number[]} i_a
 * @property {import("./map/values.js").Quantity} quantity
 * @property {(number | null)[][]} values
 * @property {boolean[][]} observed
 * @property {import("./map/values.js").Scale} scale
 * @property {(f: number, i: number) => string} describe a cell in words
 */

/** @typedef {{f_sw_hz: number, i_a: number}} Point */

/**
 * Limits in hertz and ampere; `lowest_hz` is the lowest allowed frequency of each current, null where there is none.
 * @typedef {{f_min_hz: number, f_max_hz: number, i_max_a: number, lowest_hz: (number | null)[]}} Limits
 */

/**
 * The colour of a value; null for none.
 * @param {Picture} picture
 * @param {number | null} value
 * @param {boolean} dark
 * @returns {import("./colour.js").Rgb | null}
 */
export function colourOf(picture, value, dark) {
  if (value === null) return null;
  const place = picture.scale.place(value);
  if (picture.quantity.colours === "diverging") return diverging(place, dark);
  return picture.quantity.colours === "cividis" ? cividis(place) : viridis(place);
}

/**
 * Strokes that are seen on a colour and leave the number on it readable: light on what has dark ink, dark on pale and dark.
 * @param {import("./colour.js").Rgb | null} colour
 * @returns {"light" | "dark" | "faint"}
 */
export function hatchOn(colour) {
  if (!colour || luminance(colour) > 0.5) return "faint";
  return inkOn(colour) === "#000000" ? "light" : "dark";
}

export class Heatmap {
  /**
   * @param {HTMLElement} root
   * @param {{theme: import("./theme.js").Theme, inspect: (cell: [number, number] | null) => void}} options
   *   `inspect` is told the cell under the pointer, else the focused one
   */
  constructor(root, options) {
    this.theme = options.theme;
    this.inspect = options.inspect;
    /** @type {Picture | null} */
    this.picture = null;
    /** @type {[number, number]} frequency, current */
    this.active = [0, 0];
    this.turned = false;
    /** Whether the trail's newest point is where the hob works now. */
    this.on = false;
    /** @type {any[][]} cells by [frequency][current] */
    this.cells = [];
    /** @type {Point[]} oldest first */
    this.trail = [];
    /** @type {Limits | null} */
    this.limits = null;
    this.grid = h("div", { role: "grid", class: "heatmap-grid" });
    this.lines = svg("svg", { class: "heatmap-lines", preserveAspectRatio: "none", "aria-hidden": "true" });
    this.marker = h("div", { class: "heatmap-now" });
    this.over = h("div", { class: "heatmap-over", "aria-hidden": "true" }, this.lines, this.marker);
    this.tip = h("div", { class: "heatmap-tip", "aria-hidden": "true", hidden: true });
    this.frame = h("div", { class: "heatmap" }, this.grid, this.over, this.tip);
    root.append(this.frame);
    this.#listen();
    this.resized = new ResizeObserver(() => this.#fit());
    this.resized.observe(root);
    this.root = root;
  }

  /** Ends it. */
  destroy() {
    this.resized.disconnect();
    this.frame.remove();
  }

  /** @param {Picture} picture @param {string} label what it is, for screen readers */
  show(picture, label) {
    const before = this.picture;
    this.picture = picture;
    const same = before && String(before.f_sw_hz) === String(picture.f_sw_hz) && String(before.i_a) === String(picture.i_a);
    if (!same) {
      this.active = [Math.min(this.active[0], picture.f_sw_hz.length - 1), Math.min(this.active[1], picture.i_a.length - 1)];
      this.#build();
    }
    setAttribute(this.grid, "aria-label", label);
    this.#paint();
    this.#draw();
  }

  /**
   * The working point; a trail without end points to nothing while the hob is off.
   * @param {Point[]} trail oldest first
   * @param {boolean} on whether the newest is where the hob works now
   */
  work(trail, on) {
    this.trail = trail;
    this.on = on;
    this.#drawPoint();
  }

  /** @param {Limits | null} limits */
  limit(limits) {
    this.limits = limits;
    this.#draw();
  }

  /** Puts the focus into the grid. */
  focus() {
    this.cells[this.active[0]]?.[this.active[1]]?.focus();
  }

  /** Paints again, after a change of theme. */
  repaint() {
    if (this.picture) this.#paint();
  }

  // Cells are found by two numbers each, whichever way the axes lie.
  #build() {
    const { f_sw_hz, i_a } = /** @type {Picture} */ (this.picture);
    const [rows, columns] = this.turned ? [i_a, f_sw_hz] : [f_sw_hz, i_a];
    const focused = this.grid.contains(document.activeElement);
    this.frame.style.setProperty("--rows", String(rows.length));
    this.frame.style.setProperty("--columns", String(columns.length));
    this.cells = f_sw_hz.map(() => []);
    const lines = rows.map((_, k) => {
      const row = rows.length - 1 - k; // The largest first: it is on top.
      const head = h("div", { role: "rowheader", class: "heatmap-row" }, this.#axisText(rows[row], !this.turned));
      place(head, k + 1, 1);
      const cells = columns.map((_, column) => {
        const [f, i] = this.turned ? [column, row] : [row, column];
        const cell = h("div", { role: "gridcell", class: "heatmap-cell", tabindex: "-1", data: { testid: `map-cell-${f}-${i}` } });
        cell.dataset.f = String(f);
        cell.dataset.i = String(i);
        place(cell, k + 1, column + 2);
        this.cells[f][i] = cell;
        return cell;
      });
      return h("div", { role: "row", class: "heatmap-line" }, head, cells);
    });
    const corner = h("div", { role: "columnheader", class: "heatmap-corner" }, this.turned ? "A\u2009\\\u2009kHz" : "kHz\u2009\\\u2009A");
    place(corner, rows.length + 1, 1);
    const heads = columns.map((value, column) => {
      const head = h("div", { role: "columnheader", class: "heatmap-column" }, this.#axisText(value, this.turned));
      place(head, rows.length + 1, column + 2);
      return head;
    });
    this.grid.replaceChildren(...lines, h("div", { role: "row", class: "heatmap-line" }, corner, heads));
    this.lines.setAttribute("viewBox", `0 0 ${columns.length} ${rows.length}`);
    this.#activate(this.active, focused);
  }

  /** @param {number} value @param {boolean} frequency */
  #axisText(value, frequency) {
    if (frequency) return (value / 1000).toFixed(1);
    return value >= 9.95 ? value.toFixed(0) : value.toFixed(1);
  }

  #paint() {
    const picture = /** @type {Picture} */ (this.picture);
    picture.f_sw_hz.forEach((_, f) =>
      picture.i_a.forEach((_, i) => {
        const cell = this.cells[f][i];
        const value = picture.values[f]?.[i] ?? null;
        const colour = colourOf(picture, value, this.theme.dark);
        cell.style.backgroundColor = colour ? css(colour) : "";
        cell.style.color = colour ? inkOn(colour) : "";
        const observed = picture.observed[f]?.[i] === true;
        cell.dataset.hatch = observed ? "" : hatchOn(colour);
        cell.classList.toggle("heatmap-unknown", colour === null);
        setAttribute(cell, "data-value", value === null ? null : String(value));
        const text = cellText(picture.quantity, value, picture.scale);
        setAttribute(cell, "aria-label", `${text}: ${picture.describe(f, i)}`);
        setText(cell, text);
      }),
    );
  }

  // Half a cell lies beyond each outer knot.
  #at(/** @type {Point} */ point) {
    const { f_sw_hz, i_a } = /** @type {Picture} */ (this.picture);
    const f = coordinate(f_sw_hz, point.f_sw_hz, true) + 0.5;
    const i = coordinate(i_a, point.i_a, false) + 0.5;
    return this.turned ? { x: f, y: i_a.length - i } : { x: i, y: f_sw_hz.length - f };
  }

  #draw() {
    if (!this.picture) return;
    const { i_a, f_sw_hz } = this.picture;
    const lines = [];
    const edges = { low: -1, high: i_a[i_a.length - 1] * 9 };
    if (this.limits) {
      for (const f of [this.limits.f_min_hz, this.limits.f_max_hz]) {
        lines.push(...this.#line([{ f_sw_hz: f, i_a: edges.low }, { f_sw_hz: f, i_a: edges.high }], "heatmap-range"));
      }
      const i = this.limits.i_max_a;
      lines.push(...this.#line([{ f_sw_hz: f_sw_hz[0] / 9, i_a: i }, { f_sw_hz: f_sw_hz[f_sw_hz.length - 1] * 9, i_a: i }], "heatmap-current"));
      for (const piece of pieces(i_a, this.limits.lowest_hz)) lines.push(...this.#line(piece, "heatmap-resonance"));
    }
    this.path = this.#line([], "heatmap-trail");
    this.lines.replaceChildren(...lines, ...this.path);
    this.#drawPoint();
  }

  /** Two strokes each, a light one under a dark one: they are seen on any colour. @returns {SVGElement[]} */
  #line(/** @type {Point[]} */ points, /** @type {string} */ kind) {
    return ["heatmap-under", "heatmap-stroke"].map((stroke) =>
      svg("polyline", { class: `${kind} ${stroke}`, points: this.#points(points), "vector-effect": "non-scaling-stroke" }),
    );
  }

  #points(/** @type {Point[]} */ points) {
    return points.map((point) => this.#at(point)).map(({ x, y }) => `${x.toFixed(3)},${y.toFixed(3)}`).join(" ");
  }

  #drawPoint() {
    if (!this.picture || !this.path) return;
    const points = this.#points(this.trail);
    for (const line of this.path) setAttribute(line, "points", points);
    const now = this.on ? this.trail[this.trail.length - 1] : undefined;
    this.marker.hidden = !now;
    if (!now) return;
    const { x, y } = this.#at(now);
    const [columns, rows] = this.turned ? [this.picture.f_sw_hz, this.picture.i_a] : [this.picture.i_a, this.picture.f_sw_hz];
    this.marker.style.left = `${(100 * x) / columns.length}%`;
    this.marker.style.top = `${(100 * y) / rows.length}%`;
  }

  #fit() {
    const width = this.root.clientWidth;
    const turned = width < NARROW_PX;
    const changed = turned !== this.turned;
    this.turned = turned;
    this.frame.classList.toggle("heatmap-turned", turned);
    if (!changed || !this.picture) return;
    this.#build();
    this.#paint();
    this.#draw();
  }

  #listen() {
    const cellOf = (/** @type {Event} */ event) => {
      const cell = /** @type {HTMLElement} */ (event.target).closest?.(".heatmap-cell");
      return cell instanceof HTMLElement ? /** @type {[number, number]} */ ([Number(cell.dataset.f), Number(cell.dataset.i)]) : null;
    };
    this.grid.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => this.#key(event));
    this.grid.addEventListener("focusin", (/** @type {Event} */ event) => {
      const cell = cellOf(event);
      if (!cell) return;
      this.#activate(cell, false);
      this.inspect(cell);
      this.#showTip(cell);
    });
    this.grid.addEventListener("focusout", () => this.#hideTip());
    this.grid.addEventListener("pointerover", (/** @type {PointerEvent} */ event) => {
      const cell = cellOf(event);
      if (!cell) return;
      this.inspect(cell);
      this.#showTip(cell);
    });
    this.grid.addEventListener("pointerleave", () => {
      const focused = this.grid.contains(document.activeElement);
      this.inspect(this.active);
      if (focused) this.#showTip(this.active);
      else this.#hideTip();
    });
    this.grid.addEventListener("click", (/** @type {MouseEvent} */ event) => {
      const cell = cellOf(event);
      if (cell) this.#activate(cell, true);
    });
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (!this.picture || event.altKey || event.metaKey) return;
    const [F, I] = [this.picture.f_sw_hz.length - 1, this.picture.i_a.length - 1];
    const [f, i] = this.active;
    const [up, right] = this.turned ? [[0, 1], [1, 0]] : [[1, 0], [0, 1]];
    const by = (/** @type {number[]} */ step, /** @type {number} */ n) => [f + n * step[0], i + n * step[1]];
    /** @type {Record<string, number[]>} */
    const moves = {
      ArrowUp: by(up, 1),
      ArrowDown: by(up, -1),
      ArrowRight: by(right, 1),
      ArrowLeft: by(right, -1),
      PageUp: by(up, 99),
      PageDown: by(up, -99),
      Home: event.ctrlKey ? [F * (this.turned ? 0 : 1), I * (this.turned ? 1 : 0)] : by(right, -99),
      End: event.ctrlKey ? [F * (this.turned ? 1 : 0), I * (this.turned ? 0 : 1)] : by(right, 99),
    };
    const to = moves[event.key];
    if (!to) return;
    event.preventDefault();
    const clamp = (/** @type {number} */ k, /** @type {number} */ most) => Math.min(Math.max(k, 0), most);
    this.#activate([clamp(to[0], F), clamp(to[1], I)], true);
  }

  /** @param {[number, number]} cell @param {boolean} focus */
  #activate(cell, focus) {
    const old = this.grid.querySelector(".heatmap-cell[tabindex='0']");
    old?.setAttribute("tabindex", "-1");
    this.active = cell;
    const element = this.cells[cell[0]]?.[cell[1]];
    element?.setAttribute("tabindex", "0");
    if (focus) element?.focus();
  }

  /** @param {[number, number]} cell */
  #showTip(cell) {
    const element = this.cells[cell[0]]?.[cell[1]];
    if (!element || !this.picture) return;
    setText(this.tip, this.picture.describe(...cell));
    this.tip.hidden = false;
    // Beside the cell, within the frame.
    const width = this.frame.clientWidth;
    const left = Math.min(Math.max(element.offsetLeft + element.offsetWidth / 2 - this.tip.offsetWidth / 2, 0), width - this.tip.offsetWidth);
    const above = element.offsetTop - this.tip.offsetHeight - 6;
    this.tip.style.left = `${Math.max(left, 0)}px`;
    this.tip.style.top = `${above >= 0 ? above : element.offsetTop + element.offsetHeight + 6}px`;
  }

  #hideTip() {
    this.tip.hidden = true;
  }
}

/** @param {HTMLElement} element @param {number} row @param {number} column */
function place(element, row, column) {
  element.style.gridRow = String(row);
  element.style.gridColumn = String(column);
}

/**
 * Stretches of a curve over the current's axis that are not broken by a null.
 * @param {number[]} i_a
 * @param {(number | null)[]} f_hz
 * @returns {Point[][]}
 */
export function pieces(i_a, f_hz) {
  /** @type {Point[][]} */
  const all = [[]];
  i_a.forEach((i, k) => {
    const f = f_hz[k] ?? null;
    if (f === null) all.push([]);
    else all[all.length - 1].push({ f_sw_hz: f, i_a: i });
  });
  return all.filter((piece) => piece.length > 1);
}
