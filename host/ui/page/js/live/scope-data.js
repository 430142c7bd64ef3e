// @ts-check
/** From a window of the API to what plots and tables take. */

import uPlot from "../../vendor/uplot/uPlot.esm.js";
import { envelope } from "./envelope.js";

/**
 * Columns as points: where a column holds several pairs, its least and largest follow each other, which draws the
 * vertical stroke that an oscilloscope shows.
 * @param {any} scope
 * @returns {number[][]} t, v, i
 */
export function scopeData(scope) {
  if (!scope.decimated) return [scope.t_s, scope.v_max_v, scope.i_max_a];
  const n = scope.t_s.length;
  const quarter = n > 1 ? (scope.t_s[n - 1] - scope.t_s[0]) / (n - 1) / 4 : 0;
  const periods = (scope.to_s - scope.from_s) * scope.f_sw_hz;
  const [vLeast, vLargest] = envelope(scope.v_min_v, scope.v_max_v, periods);
  const [iLeast, iLargest] = envelope(scope.i_min_a, scope.i_max_a, periods);
  const t = new Array(2 * n);
  const v = new Array(2 * n);
  const i = new Array(2 * n);
  for (let k = 0; k < n; k += 1) {
    const [a, b] = [2 * k, 2 * k + 1];
    t[a] = scope.t_s[k] - quarter;
    t[b] = scope.t_s[k] + quarter;
    v[a] = vLeast[k];
    v[b] = vLargest[k];
    i[a] = iLeast[k];
    i[b] = iLargest[k];
  }
  return [t, v, i];
}

/**
 * The columns as they came, for CSV.
 * @param {any} scope
 * @returns {{remarks: string[], head: string[], rows: any[][]}}
 */
export function scopeTable(scope) {
  if (!scope) return { remarks: ["no window"], head: [], rows: [] };
  return {
    remarks: [`window ${scope.seq} of boot ${scope.boot}, ${scope.f_sw_hz} Hz, ${scope.sample_rate_hz} pairs a second, columns ${scope.decimated ? "of several pairs" : "of one pair"}`],
    head: ["t / s", "v least / V", "v largest / V", "i least / A", "i largest / A"],
    rows: scope.t_s.map((/** @type {number} */ t, /** @type {number} */ k) => [t, scope.v_min_v[k], scope.v_max_v[k], scope.i_min_a[k], scope.i_max_a[k]]),
  };
}

/**
 * @param {"R" | "L"} quantity
 * @returns {import("../plot.js").PlotAxis[]}
 */
export function loadAxes(quantity) {
  return quantity === "R" ? [{ key: "y", label: "R", unit: "Ω" }] : [{ key: "y", label: "L", unit: "µH", factor: 1e6 }];
}

/**
 * @param {"R" | "L"} quantity
 * @returns {import("../plot.js").PlotSeries[]}
 */
export function loadSeries(quantity) {
  const digits = quantity === "R" ? 3 : 2;
  return [
    { label: "Kalman filter", axis: "y", colour: "s2", width: 1, dash: [2, 2], digits },
    { label: "network ± 2σ", axis: "y", colour: "s1", width: 1.75, digits },
    { label: `${quantity} + 2σ`, axis: "y", colour: "s1", band: "high" },
    { label: `${quantity} − 2σ`, axis: "y", colour: "s1", band: "low" },
    { label: "truth", axis: "y", colour: "s5", width: 1.25, dash: [8, 4], digits },
  ];
}

/**
 * R or L of the Kalman filter, network and truth on one axis of time.
 * @param {any} scope
 * @param {"R" | "L"} quantity
 * @returns {any[][]} t, filter, network, network + 2σ, network − 2σ, truth
 */
export function loadData(scope, quantity) {
  const value = quantity === "R" ? "r_ohm" : "l_h";
  const sigma = quantity === "R" ? "r_sigma_ohm" : "l_sigma_h";
  const { ekf, network, truth } = scope;
  const spread = network && network[sigma].length === network.t_s.length;
  const edge = (/** @type {number} */ sign) => network[value].map((/** @type {number | null} */ x, /** @type {number} */ k) => {
    const s = network[sigma][k];
    return typeof x === "number" && typeof s === "number" ? x + sign * 2 * s : null;
  });
  const joined = uPlot.join([
    [ekf.t_s, ekf[value]],
    network ? [network.t_s, network[value], spread ? edge(1) : network[value], spread ? edge(-1) : network[value]] : [[], [], [], []],
    truth ? [truth.t_s, truth[value]] : [[], []],
  ]);
  return joined[0].length ? joined : [[], [], [], [], [], []];
}
