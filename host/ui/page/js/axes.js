// @ts-check
/** Words on axes. */

import { decimalsOf, fixed } from "./format.js";

/**
 * Numbers of an axis in its unit, with as many decimals as the distance of two needs.
 * @param {number} factor from SI to the axis's unit
 * @returns {(u: any, splits: (number | null)[], axis: number, space: number, increment: number) => string[]}
 */
export function axisValues(factor) {
  return (_u, splits, _axis, _space, increment) => {
    const decimals = Math.min(6, decimalsOf(Number((increment * factor).toPrecision(6))));
    return splits.map((value) => {
      if (value === null || value === undefined) return "";
      const shown = value * factor;
      return fixed(shown, increment ? decimals : Math.max(0, Math.ceil(-Math.log10(Math.abs(shown) || 1) - 1e-9)));
    });
  };
}

/**
 * Powers of ten of a logarithmic axis in its unit: `0.01` to `1000` as they are, beyond as `10⁻⁴`.
 * @param {number} factor from SI to the axis's unit
 * @returns {(u: any, splits: (number | null)[]) => string[]}
 */
export function decadeValues(factor) {
  const raised = (/** @type {number} */ power) => String(power).replace("-", "⁻").replace(/\d/g, (digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(digit)]);
  return (_u, splits) =>
    splits.map((value) => {
      if (value === null || value === undefined) return "";
      const power = Math.round(Math.log10(value * factor));
      return power >= -2 && power <= 3 ? fixed(value * factor, Math.max(0, -power)) : `10${raised(power)}`;
    });
}

const two = (/** @type {number} */ n) => String(n).padStart(2, "0");

/**
 * Times of day of an axis in seconds since 1970; the day too where it changes.
 * @param {any} _u
 * @param {(number | null)[]} splits
 * @param {number} _axis
 * @param {number} _space
 * @param {number} increment in seconds
 * @returns {string[]}
 */
export function timeValues(_u, splits, _axis, _space, increment) {
  return splits.map((value) => {
    if (value === null || value === undefined) return "";
    const d = new Date(value * 1000);
    const minutes = `${two(d.getHours())}:${two(d.getMinutes())}`;
    if (increment >= 86_400) return `${two(d.getMonth() + 1)}-${two(d.getDate())}`;
    if (increment >= 60) return minutes;
    if (increment >= 1) return `${minutes}:${two(d.getSeconds())}`;
    return `${minutes}:${fixed(d.getSeconds() + d.getMilliseconds() / 1000, decimalsOf(increment))}`;
  });
}

/** Distances of ticks of a time axis, in seconds. */
export const TIME_STEPS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10_800, 21_600,
  43_200, 86_400, 172_800];
