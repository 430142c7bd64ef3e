// @ts-check
/** What a map's cells and scales say, in words and numbers with units. */

import { duration, fixed, NOTHING, si } from "../format.js";
import { prefixOf } from "./values.js";

/**
 * A value of a quantity with its unit.
 * @param {import("./values.js").Quantity} of
 * @param {number | null} value
 */
export function valueText(of, value) {
  if (value === null) return NOTHING;
  if (of.id === "age") return duration(value);
  if (of.scale === "unit") return fixed(value, 2);
  if (of.scale === "diverging") return percent(value);
  return si(value, of.unit, 4);
}

/** A difference with its sign: `+1.24 %`, `+0.021 %`. @param {number | null} value */
export function percent(value) {
  if (value === null) return NOTHING;
  const text = fixed(value, Math.abs(value) < 0.0995 ? 3 : 2);
  return `${value > 0 && Number(text) !== 0 ? "+" : ""}${text}\u00a0%`;
}

/** A deviation in percent, as finely as the store keeps it. @param {number} value */
export function deviation(value) {
  if (value < 0.01) return "under\u00a00.01\u00a0%";
  return value > 600 ? "over\u00a0600\u00a0%" : `${fixed(value, value < 0.995 ? 2 : value < 9.95 ? 1 : 0)}\u00a0%`;
}

/** A value with its deviation where that is known. @param {string} text @param {number | null} sigma_pct */
export const withDeviation = (text, sigma_pct) => (sigma_pct === null ? text : `${text}\u00a0±\u00a0${deviation(sigma_pct)}`);

/** A tick of the colour bar. @param {import("./values.js").Quantity} of @param {number} tick @param {import("./values.js").Scale} scale */
export function tickText(of, tick, scale) {
  if (of.id === "age") return tick < 60 ? `${fixed(tick, tick < 1 ? 1 : 0)}\u00a0s` : duration(tick).replace(/\u00a0(min|h|d) 0\u00a0\S+$/, "\u00a0$1");
  if (of.scale === "log") return of.unit === "%" ? String(Number(tick.toPrecision(1))) : si(tick, of.unit, 1);
  if (of.scale === "unit") return String(tick);
  if (of.scale === "diverging") return `${tick > 0 ? "+" : ""}${fixed(tick, decimals(scale))}`;
  return fixed(tick / prefixOf(of, scale)[0], decimals(scale, prefixOf(of, scale)[0]));
}

/** Decimals that tell a bar's ticks apart. @param {import("./values.js").Scale} scale @param {number} factor */
function decimals(scale, factor = 1) {
  const step = (scale.ticks[1] - scale.ticks[0]) / factor;
  return Number.isFinite(step) && step > 0 ? Math.min(Math.max(0, -Math.floor(Math.log10(step * 1.0001))), 6) : 2;
}

/**
 * A quantity with the unit in which the colour bar and the cells are written: `L / µH`.
 * @param {import("./values.js").Quantity} of
 * @param {import("./values.js").Scale} scale
 */
export function title(of, scale) {
  if (of.scale === "unit" || (of.scale === "log" && of.unit !== "%")) return of.name;
  return `${of.name} / ${prefixOf(of, scale)[1]}${of.unit}`;
}

/**
 * Everything that is known of a cell.
 * @typedef {object} CellNumbers
 * @property {number} f_sw_hz
 * @property {number} i_a
 * @property {number | null} r_ohm
 * @property {number | null} l_h
 * @property {number | null} power_w
 * @property {number | null} sigma_r_pct
 * @property {number | null} sigma_l_pct
 * @property {boolean} observed
 * @property {number | null} confidence
 * @property {number | null} age_s
 * @property {number | null} r_difference_pct
 * @property {number | null} l_difference_pct
 */

/**
 * A cell in one line, for the tooltip and for screen readers.
 * @param {CellNumbers} cell
 * @param {import("./values.js").Quantity} of
 * @param {number | null} value what is shown of it
 */
export function cellWords(cell, of, value) {
  const parts = [
    `${si(cell.f_sw_hz, "Hz")}, ${fixed(cell.i_a, 1)}\u00a0A`,
    `R\u00a0${withDeviation(si(cell.r_ohm, "Ω", 4), cell.sigma_r_pct)}`,
    `L\u00a0${withDeviation(si(cell.l_h, "H", 4), cell.sigma_l_pct)}`,
    cell.observed ? "known" : "not known",
  ];
  // R and L are there with their deviations.
  if (!/^[rl](-sigma)?$/.test(of.id)) parts.splice(1, 0, `${of.name} ${valueText(of, value)}`);
  return parts.join(" · ");
}

