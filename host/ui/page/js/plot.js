// @ts-check
/**
 * A plot: uPlot with the page's theme, a legend beside the curves, keys, and what is seen as PNG and CSV.
 *
 * Data are in SI units; an axis shows them with its own factor: `{label: "L", unit: "µH", factor: 1e6}`.
 */

import uPlot from "../vendor/uplot/uPlot.esm.js";
import { h, setText } from "./dom.js";
import { csv, downloadCsv, fileName } from "./export.js";
import { clock, fixed, isoUtc, NOTHING } from "./format.js";
import { exportPng } from "./plot-image.js";
import { bindKeys, bindPointer } from "./plot-input.js";
import { axisSize, uplotOptions } from "./plot-options.js";
import { tableOf } from "./plot-table.js";
import { swatch } from "./swatch.js";

/**
 * @typedef {{key: string, label: string, unit: string, factor?: number, side?: "left" | "right", log?: boolean,
 *   range?: (least: number | null, most: number | null) => [number, number]}} PlotAxis
 * @typedef {{label: string, axis: string, colour: string, width?: number, dash?: number[], marker?: Marker,
 *   line?: boolean, band?: "low" | "high", hidden?: boolean, digits?: number}} PlotSeries
 *   `band` marks an edge: no line, no entry in the legend
 * @typedef {"circle" | "square" | "triangle" | "cross"} Marker
 * @typedef {{high: number, low: number, colour: string}} PlotBand series by number, from 1; colour a variable
 * @typedef {{from: number, to: number}} View
 *
 * @typedef {object} PlotOptions
 * @property {string} title
 * @property {string} name                stem of files
 * @property {() => string} device        whose data it is, for files
 * @property {import("./theme.js").Theme} theme
 * @property {(text: string) => void} announce
 * @property {{label: string, unit: string, factor?: number, time?: boolean}} x
 * @property {PlotAxis[]} axes
 * @property {PlotSeries[]} series
 * @property {PlotBand[]} [bands]
 * @property {() => number} [height]      of the drawing, in CSS pixels; asked again when the window changes
 * @property {string} [sync]              plots of one name share their cursor
 * @property {(view: View | null) => void} [onView]   a person zoomed or panned; null: back to the whole
 * @property {View} [bounds]              how far a person may pan
 * @property {((plot: any, theme: import("./theme.js").Theme) => void)[]} [under]   drawn below the curves
 * @property {((plot: any, theme: import("./theme.js").Theme) => void)[]} [over]    drawn above them
 * @property {() => {remarks: string[], head: string[], rows: any[][]}} [table]     for CSV, where it is not the data
 * @property {{label: string, colour: string, dash?: number[], marker?: Marker}[]} [notes]   further legend entries
 */

export class Plot {
  /**
   * @param {HTMLElement} root where it is put
   * @param {PlotOptions} options
   */
  constructor(root, options) {
    this.options = options;
    /** @type {any[][]} */
    this.data = [[], ...options.series.map(() => [])];
    /** @type {View | null} what is shown; null: all that there is */
    this.view = null;
    this.at_ms = 0;
    /** @type {(HTMLElement | null)[]} where values at the cursor stand */
    this.values = options.series.map((one) => (one.band ? null : h("span", { class: "legend-value" })));
    this.#build(root);
    /** @type {any} */
    this.uplot = new (/** @type {any} */ (uPlot))(
      uplotOptions(options, this.#width(), this.#height(), { cursor: () => this.#showCursor(), selected: (u) => this.#selected(u) }), this.data, this.canvas);
    this.stopTheme = options.theme.on(() => this.uplot.redraw(false, true));
    this.observer = new ResizeObserver(() => this.#resize());
    this.observer.observe(this.canvas);
    const resized = () => this.#resize();
    addEventListener("resize", resized);
    this.stopInput = [bindKeys(this), bindPointer(this), () => removeEventListener("resize", resized)];
  }

  /**
   * @param {any[][]} data x, then a list for each series; null is a gap
   * @param {number} [at_ms] when it was measured, since 1970
   */
  set(data, at_ms = Date.now()) {
    this.data = data;
    this.at_ms = at_ms;
    this.uplot.setData(data, false);
    this.#applyView();
  }

  /**
   * Shows a part; null: all that there is.
   * @param {View | null} view
   */
  show(view) {
    this.view = view;
    this.#applyView();
  }

  /** @returns {View} what is seen now */
  seen() {
    const { min, max } = this.uplot.scales.x;
    return { from: min ?? 0, to: max ?? 1 };
  }

  /**
   * A person asks for a part: kept within the bounds, told to the owner.
   * @param {View | null} view
   */
  ask(view) {
    const bounds = this.options.bounds;
    let wanted = view;
    if (wanted && bounds) {
      const width = Math.min(wanted.to - wanted.from, bounds.to - bounds.from);
      const from = Math.min(Math.max(wanted.from, bounds.from), bounds.to - width);
      wanted = width >= bounds.to - bounds.from ? null : { from, to: from + width };
    }
    if (this.options.onView) this.options.onView(wanted);
    else this.show(wanted);
  }

  /** @returns {number} width of the drawing area in device pixels: as many columns are worth asking for */
  columns() {
    const device = Math.round((this.uplot.bbox.width / uPlot.pxRatio) * Math.min(devicePixelRatio, 2));
    return Math.max(100, Math.min(4000, device || 600));
  }

  /** Draws anew with the same data. */
  redraw() {
    this.uplot.redraw(false, false);
  }

  /** Ends it. */
  destroy() {
    this.stopTheme();
    this.observer.disconnect();
    for (const stop of this.stopInput) stop();
    this.uplot.destroy();
    this.figure.remove();
  }

  /** Says the values below the cursor, for who cannot see it. */
  sayCursor() {
    const index = this.uplot.cursor.idx;
    if (index === null || index === undefined) return;
    const values = this.options.series
      .map((series, i) => (series.band ? "" : `${series.label} ${this.#valueText(i, index)}`))
      .filter(Boolean);
    this.options.announce(`${this.#xText(this.data[0][index])}: ${values.join(", ")}`);
  }

  /** @param {HTMLElement} root */
  #build(root) {
    const { title, series } = this.options;
    this.xValue = h("span", { class: "legend-x quiet" });
    const entries = series.map((one, i) => (one.band ? null : this.#entry(one, i)));
    const notes = (this.options.notes ?? []).map((note) => h("li", { class: "legend-note" }, swatch(note), h("span", {}, note.label)));
    this.canvas = h("div", {
      class: "plot-canvas", tabindex: "0", role: "group",
      "aria-label": `${title}: plot. Arrows move the cursor, plus and minus zoom, page up and down pan, 0 shows all.`,
    });
    this.figure = h("figure", { class: "plot", "aria-label": title },
      h("figcaption", { class: "plot-head" },
        h("span", { class: "plot-title" }, title),
        h("ul", { class: "legend" }, entries, notes),
        this.xValue,
        h("span", { class: "plot-tools" },
          h("button", { type: "button", class: "small", "aria-label": `${title}: show all`, title: "show all (0)", on: { click: () => this.ask(null) } }, "all"),
          h("button", { type: "button", class: "small", "aria-label": `${title}: save as PNG`, on: { click: () => exportPng(this) } }, "PNG"),
          h("button", { type: "button", class: "small", "aria-label": `${title}: save as CSV`, on: { click: () => this.saveCsv() } }, "CSV"))),
      this.canvas);
    root.append(this.figure);
  }

  /**
   * @param {PlotSeries} one
   * @param {number} i
   */
  #entry(one, i) {
    const button = h("button", { type: "button", class: "legend-entry", "aria-pressed": String(!one.hidden),
      title: `show or hide ${one.label}`, on: { click: () => this.#toggle(button, i) } },
      swatch(one), h("span", {}, one.label), this.values[i]);
    return h("li", null, button);
  }

  /**
   * @param {HTMLElement} button
   * @param {number} i
   */
  #toggle(button, i) {
    const show = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(show));
    this.uplot.setSeries(i + 1, { show });
    for (const band of this.options.bands ?? []) {
      if (this.#ownerOf(band) !== i) continue;
      this.uplot.setSeries(band.high, { show });
      this.uplot.setSeries(band.low, { show });
    }
  }

  /**
   * The series whose spread a band is: the last one before it that is a curve.
   * @param {PlotBand} band
   */
  #ownerOf(band) {
    let i = Math.min(band.high, band.low) - 1;
    while (i >= 0 && this.options.series[i].band) i -= 1;
    return i;
  }

  #width() {
    return Math.max(200, Math.floor(this.canvas.clientWidth || 600));
  }

  #resize() {
    const width = this.#width();
    if (width === this.uplot.width && this.#height() === this.uplot.height) return;
    const size = axisSize(width);
    this.uplot.axes.forEach((/** @type {any} */ axis, /** @type {number} */ i) => {
      if (i > 0) axis.size = () => size;
    });
    this.uplot.setSize({ width, height: this.#height() });
  }

  #height() {
    return Math.round(this.options.height?.() ?? 160);
  }

  #applyView() {
    const x = this.data[0];
    if (this.view) this.uplot.setScale("x", { min: this.view.from, max: this.view.to });
    else if (x.length > 1) this.uplot.setScale("x", { min: x[0], max: x[x.length - 1] });
    else if (x.length === 1) this.uplot.setScale("x", { min: x[0] - 0.5, max: x[0] + 0.5 });
  }

  #showCursor() {
    const index = this.uplot?.cursor.idx;
    const known = index !== null && index !== undefined && this.data[0].length > 0;
    setText(this.xValue, known ? this.#xText(this.data[0][index]) : "");
    this.values.forEach((element, i) => {
      if (element) setText(element, known ? this.#valueText(i, index) : "");
    });
  }

  /** @param {any} u */
  #selected(u) {
    if (u.select.width < 4) return;
    const from = u.posToVal(u.select.left, "x");
    const to = u.posToVal(u.select.left + u.select.width, "x");
    u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    this.ask({ from, to });
  }

  /** @param {number} value */
  #xText(value) {
    const { x } = this.options;
    if (value === undefined || value === null) return "";
    return x.time ? clock(value * 1000) : `${fixed(value * (x.factor ?? 1), 3)}\u00a0${x.unit}`;
  }

  /**
   * @param {number} i number of the series, from 0
   * @param {number} index of the point
   */
  #valueText(i, index) {
    const one = this.options.series[i];
    const axis = this.options.axes.find((candidate) => candidate.key === one.axis);
    const value = nearest(this.data[i + 1], index);
    if (value === null || !axis) return NOTHING;
    return `${fixed(value * (axis.factor ?? 1), one.digits ?? 2)}\u00a0${axis.unit}`;
  }

  /** What is seen, as CSV. */
  saveCsv() {
    const { title, name, device } = this.options;
    const { remarks, head, rows } = tableOf(this);
    const first = [`${title}, device ${device()}`, `measured ${isoUtc(this.at_ms)}, saved ${isoUtc(Date.now())}`];
    downloadCsv(fileName([device(), name], Date.now(), "csv"), csv([...first, ...remarks], head, rows));
  }
}

/**
 * The value at a place, or the nearest one beside it: curves of different rates share an axis.
 * @param {(number | null | undefined)[]} values
 * @param {number} index
 * @returns {number | null}
 */
function nearest(values, index) {
  for (let d = 0; d < 12; d += 1) {
    for (const k of [index - d, index + d]) {
      const value = values[k];
      if (value !== null && value !== undefined) return value;
    }
  }
  return null;
}
