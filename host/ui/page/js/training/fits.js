// @ts-check
/** Fits of a device's windows as a list, and what became of them. */

/**
 * @typedef {object} Fit
 * @property {number} boot
 * @property {number} seq
 * @property {number} at_ms
 * @property {number} f_sw_hz
 * @property {number | null} r_ohm
 * @property {number | null} l_h
 * @property {number | null} sigma_r_pct
 * @property {number | null} sigma_l_pct
 * @property {boolean} pass
 * @property {string} why
 * @property {{code: string, severity: string, text: string}[]} remarks
 * @property {boolean} changed_lookup
 * @property {number} iterations
 * @property {number | null} seconds
 * @property {{step: number, loss: number, change: number}[]} steps
 * @property {number | null} r_error_pct
 * @property {number | null} l_error_pct
 */

/** What a fit is known by. @param {{boot: number, seq: number}} fit */
export const keyOf = (fit) => `${fit.boot}/${fit.seq}`;

/**
 * The list with what was read anew, newest first, at most so many.
 * @param {Fit[]} list
 * @param {Fit[]} page newest first
 * @param {number} limit
 * @returns {{list: Fit[], hole: boolean}} a hole where more happened between the two than the page holds
 */
export function withNewest(list, page, limit) {
  const read = new Set(page.map(keyOf));
  const rest = list.filter((fit) => !read.has(keyOf(fit)));
  const hole = list.length > 0 && page.length > 0 && rest.length === list.length;
  const all = [...page, ...rest].sort((a, b) => b.at_ms - a.at_ms || b.seq - a.seq);
  return { list: all.slice(0, limit), hole };
}

/** Why a fit was refused, as one of few reasons: the code of what refused it, or the words without their numbers. @param {Fit} fit */
export function reason(fit) {
  if (fit.pass) return "";
  const error = fit.remarks.find((remark) => remark.severity === "error");
  if (error) return error.code;
  const words = fit.why.split(/[;:\n]/)[0].replaceAll(/[-\u2212+]?\d[\d\u00a0 .,]*/g, "… ").replaceAll(/\s+/g, " ").trim();
  return words || "no reason given";
}

/**
 * Verdicts of a list.
 * @param {Fit[]} fits
 * @returns {{passed: number, refused: number, reasons: {reason: string, count: number}[]}} most frequent reason first
 */
export function verdicts(fits) {
  /** @type {Map<string, number>} */
  const counts = new Map();
  for (const fit of fits) if (!fit.pass) counts.set(reason(fit), (counts.get(reason(fit)) ?? 0) + 1);
  const reasons = [...counts].map(([text, count]) => ({ reason: text, count })).sort((a, b) => b.count - a.count || a.reason.localeCompare(b.reason));
  const refused = fits.filter((fit) => !fit.pass).length;
  return { passed: fits.length - refused, refused, reasons };
}

/** For a logarithmic axis: what is not above zero has no place on it. @param {number | null | undefined} value */
export const aboveZero = (value) => (Number.isFinite(value) && Number(value) > 0 ? Number(value) : null);

/**
 * Whole decades that hold all values: a logarithmic axis has a mark at each end.
 * @param {number | null} least
 * @param {number | null} most
 * @returns {[number, number]}
 */
export function decades(least, most) {
  if (!(Number(least) > 0) || !(Number(most) > 0)) return [0.1, 10];
  const low = Math.floor(Math.log10(Number(least)) + 1e-9);
  const high = Math.ceil(Math.log10(Number(most)) - 1e-9);
  return [Number(`1e${low}`), Number(`1e${Math.max(high, low + 1)}`)];
}
