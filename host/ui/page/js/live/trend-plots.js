// @ts-check
/** The five plots of the past: power, R, L, frequency with resonance, phase. They share x and cursor. */

import { isoUtc } from "../format.js";
import { Plot } from "../plot.js";
import { bars, level } from "./marks.js";

/** Least height of each, in CSS pixels, and what stands around it. */
const MIN_HEIGHT = 140;
const HEAD = 34;

/** All five in the window where they have a column of their own (css/live.css). */
const height = () => (innerWidth < 1900 ? MIN_HEIGHT : Math.max(MIN_HEIGHT, (innerHeight - 160) / 5 - HEAD));

export class TrendPlots {
  /**
   * @param {HTMLElement} root
   * @param {import("../context.js").Context} context
   * @param {import("./trend-columns.js").TrendColumns} columns
   * @param {{zoom: (view: import("../plot.js").View | null) => void, bounds: () => import("../plot.js").View}} owner
   */
  constructor(root, context, columns, owner) {
    this.context = context;
    this.columns = columns;
    this.limits = true;
    this.seen = { from: 0, to: 1 };
    const shared = {
      theme: context.theme, announce: context.announce, device: () => context.device, height, sync: "trend",
      x: { label: "time", unit: "local", time: true }, onView: owner.zoom,
      get bounds() {
        return owner.bounds();
      },
    };
    const make = (/** @type {any} */ own) => new Plot(root, /** @type {any} */ (Object.defineProperties(own, Object.getOwnPropertyDescriptors(shared))));
    this.power = make(this.#powerOptions());
    this.r = make(this.#loadOptions("R"));
    this.l = make(this.#loadOptions("L"));
    this.frequency = make(this.#frequencyOptions());
    this.phase = make(this.#phaseOptions());
    this.all = [this.power, this.r, this.l, this.frequency, this.phase];
  }

  /** Ends them. */
  destroy() {
    for (const plot of this.all) plot.destroy();
  }

  /** @returns {number} columns that are worth asking for */
  columnCount() {
    return Math.min(1500, this.power.columns());
  }

  /** @param {boolean} limits whether axes reach to the limits */
  showLimits(limits) {
    this.limits = limits;
    this.draw(this.seen);
  }

  /**
   * @param {import("../plot.js").View} view in seconds since 1970
   */
  draw(view) {
    this.seen = view;
    const { at_s, quantities: q, asked_w, phase_deg, resonance_hz } = this.columns;
    const margin = this.context.hob.resonance_margin;
    const at_ms = view.to * 1000;
    const set = (/** @type {Plot} */ plot, /** @type {any[][]} */ data) => {
      plot.view = view;
      plot.set([at_s, ...data], at_ms);
    };
    set(this.power, [q.power_w.mean, q.power_w.max, q.power_w.min, asked_w]);
    set(this.r, [q.r_ohm.mean, q.r_ohm.max, q.r_ohm.min]);
    set(this.l, [q.l_h.mean, q.l_h.max, q.l_h.min]);
    set(this.frequency, [q.f_sw_hz.mean, q.f_sw_hz.max, q.f_sw_hz.min, resonance_hz, resonance_hz.map((f) => (f === null ? null : f * margin))]);
    set(this.phase, [phase_deg]);
  }

  #powerOptions() {
    const rated = this.context.hob.rated_power_w;
    return {
      title: "Power", name: "power",
      axes: [{ key: "y", label: "P", unit: "W", range: (/** @type {any} */ _a, /** @type {any} */ b) => padded(0, Math.max(b ?? 0, 50, this.limits ? rated : 0)) }],
      series: [
        { label: "delivered", axis: "y", colour: "s1", width: 1.5, digits: 0 }, ...edges("y", "s1"),
        { label: "asked", axis: "y", colour: "s2", dash: [6, 3], digits: 0 },
      ],
      bands: [{ high: 2, low: 3, colour: "b1" }],
      notes: [{ label: `rated ${rated} W`, colour: "s7", dash: [2, 3] }],
      under: [(/** @type {any} */ u, /** @type {any} */ t) => level(u, t, rated)],
    };
  }

  /** @param {"R" | "L"} quantity */
  #loadOptions(quantity) {
    const r = quantity === "R";
    const key = r ? "r_ohm" : "l_h";
    const points = () => {
      const { results } = this.columns;
      return { at_s: results.at_s, value: r ? results.r_ohm : results.l_h, sigma: r ? results.r_sigma : results.l_sigma, pass: results.pass };
    };
    return {
      title: quantity, name: r ? "r" : "l",
      axes: [r
        ? { key: "y", label: "R", unit: "Ω", range: (/** @type {any} */ a, /** @type {any} */ b) => this.#around(points(), a, b, 10) }
        : { key: "y", label: "L", unit: "µH", factor: 1e6, range: (/** @type {any} */ a, /** @type {any} */ b) => this.#around(points(), a, b, 100e-6) }],
      series: [{ label: "device, at the crest", axis: "y", colour: "s2", width: 1.5, digits: r ? 3 : 2 }, ...edges("y", "s2")],
      bands: [{ high: 2, low: 3, colour: "b2" }],
      notes: [
        { label: "network ± 2σ, mean over i²", colour: "s1", marker: "circle", line: false },
        { label: "refused by the gate", colour: "s4", marker: "cross", line: false },
      ],
      over: [(/** @type {any} */ u, /** @type {any} */ t) => bars(u, t, points())],
      table: () => this.#loadTable(key, points()),
    };
  }

  #frequencyOptions() {
    const { f_sw_min_hz: low, f_sw_max_hz: high, resonance_margin: margin } = this.context.hob;
    return {
      title: "Switching frequency and resonance", name: "frequency",
      axes: [{ key: "y", label: "f", unit: "kHz", factor: 1e-3, range: (/** @type {any} */ a, /** @type {any} */ b) =>
        padded(Math.min(a ?? low, this.limits ? low : Infinity), Math.max(b ?? high, this.limits ? high : 0)) }],
      series: [
        { label: "f_sw", axis: "y", colour: "s1", width: 1.5, digits: 2 }, ...edges("y", "s1"),
        { label: "resonance", axis: "y", colour: "s3", dash: [6, 3], digits: 2 },
        { label: `resonance × ${margin.toFixed(3)}, least`, axis: "y", colour: "s4", dash: [2, 2], digits: 2 },
      ],
      bands: [{ high: 2, low: 3, colour: "b1" }],
      notes: [{ label: `limits ${low / 1e3} and ${high / 1e3} kHz`, colour: "s7", dash: [2, 3] }],
      under: [(/** @type {any} */ u, /** @type {any} */ t) => {
        level(u, t, low);
        level(u, t, high);
      }],
    };
  }

  #phaseOptions() {
    return {
      title: "Phase of the inverter's voltage before its current", name: "phase",
      axes: [{ key: "y", label: "φ", unit: "°", range: (/** @type {any} */ a, /** @type {any} */ b) => padded(Math.min(0, a ?? 0), Math.max(b ?? 90, this.limits ? 90 : 1)) }],
      series: [{ label: "phase, at the crest", axis: "y", colour: "s3", width: 1.5, digits: 1 }],
    };
  }

  /**
   * A range that holds the curve and the network's points in the view.
   * @param {{at_s: number[], value: (number | null)[]}} points
   * @param {number | null} least
   * @param {number | null} most
   * @param {number} top of the axis while there is neither
   * @returns {[number, number]}
   */
  #around(points, least, most, top) {
    let low = least ?? Infinity;
    let high = most ?? -Infinity;
    const { at_s, value } = points;
    for (let k = at_s.length - 1; k >= 0 && at_s[k] >= this.seen.from; k -= 1) {
      const y = value[k];
      if (y === null || at_s[k] > this.seen.to) continue;
      low = Math.min(low, y);
      high = Math.max(high, y);
    }
    if (!(low <= high)) return [0, top];
    // A quiet load is shown quiet: two percent of its value at least.
    const room = Math.max(0, 0.02 * high - (high - low)) / 2;
    return padded(low - room, high + room);
  }

  /**
   * Columns and results in one table, in the order of time.
   * @param {"r_ohm" | "l_h"} key
   * @param {{at_s: number[], value: (number | null)[], sigma: (number | null)[], pass: boolean[]}} points
   */
  #loadTable(key, points) {
    const unit = key === "r_ohm" ? "R / ohm" : "L / H";
    const { at_s, quantities } = this.columns;
    const { min, mean, max } = quantities[key];
    const rows = at_s.map((s, k) => [s, isoUtc(s * 1000), min[k], mean[k], max[k], null, null, null]);
    points.at_s.forEach((s, k) => rows.push([s, isoUtc(s * 1000), null, null, null, points.value[k], points.sigma[k], points.pass[k] ? "passed" : "refused"]));
    rows.sort((a, b) => Number(a[0]) - Number(b[0]));
    return {
      remarks: [`columns of ${this.columns.step_ms} ms from the device, and results of the network`],
      head: ["time / s since 1970", "time (UTC)", `device ${unit} least`, `device ${unit} mean`, `device ${unit} largest`, `network ${unit}`, "network sigma / %", "gate"],
      rows,
    };
  }
}

/**
 * Edges of the band between the least and the largest of each column.
 * @param {string} axis
 * @param {string} colour
 */
function edges(axis, colour) {
  return [
    { label: "largest", axis, colour, band: /** @type {const} */ ("high") },
    { label: "least", axis, colour, band: /** @type {const} */ ("low") },
  ];
}

/**
 * @param {number} low
 * @param {number} high
 * @returns {[number, number]}
 */
function padded(low, high) {
  const room = Math.max(1e-12, (high - low) * 0.05);
  return [low === 0 ? 0 : low - room, high + room];
}
