// @ts-check
/** Numbers with SI prefixes and units, times, durations. Values are in SI units throughout. */

const PREFIXES = [
  [1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"],
];

/** What stands where nothing is known. */
export const NOTHING = "–";

/**
 * A number with so many significant digits, never in exponents, with a true minus sign.
 * @param {number} value
 * @param {number} [digits]
 * @returns {string}
 */
export function significant(value, digits = 3) {
  if (!Number.isFinite(value)) return NOTHING;
  if (value === 0) return "0";
  const rounded = Number(value.toPrecision(digits));
  const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(Math.abs(rounded))));
  return fixed(rounded, decimals);
}

/**
 * A number with so many decimals, with a true minus sign; a zero has none.
 * @param {number | null | undefined} value
 * @param {number} [decimals]
 * @returns {string}
 */
export function fixed(value, decimals = 0) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NOTHING;
  const text = value.toFixed(decimals);
  if (Number(text) === 0) return text.replace("-", "");
  return text.replace("-", "\u2212");
}

/**
 * The prefix that leaves one to three digits before the point.
 * @param {number} value
 * @param {number} [digits]
 * @returns {[number, string]} factor of the prefix, and the prefix
 */
export function prefixOf(value, digits = 3) {
  const size = Math.abs(Number(value.toPrecision(digits)));
  if (size === 0 || !Number.isFinite(size)) return [1, ""];
  for (const [factor, prefix] of PREFIXES) {
    if (size >= /** @type {number} */ (factor)) return /** @type {[number, string]} */ ([factor, prefix]);
  }
  return [1e-12, "p"];
}

/**
 * A quantity with unit: `28.9 µH`.
 * @param {number | null | undefined} value in the unit without prefix
 * @param {string} unit
 * @param {number} [digits] significant ones
 * @returns {string}
 */
export function si(value, unit, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NOTHING;
  const [factor, prefix] = prefixOf(value, digits);
  return `${significant(value / factor, digits)}\u00a0${prefix}${unit}`;
}

/**
 * Watt without a prefix, as hobs are rated.
 * @param {number | null | undefined} power_w
 * @returns {string}
 */
export function watt(power_w) {
  return power_w === null || power_w === undefined || !Number.isFinite(power_w)
    ? NOTHING
    : `${fixed(power_w, 0)}\u00a0W`;
}

/**
 * A value and its standard deviation, with the digits that the latter leaves.
 * @param {number} value
 * @param {number | null | undefined} sigma
 * @param {string} unit
 * @returns {string}
 */
export function withSigma(value, sigma, unit) {
  if (sigma === null || sigma === undefined || !(sigma > 0)) return si(value, unit, 4);
  const [factor, prefix] = prefixOf(value, 4);
  const decimals = Math.min(6, Math.max(0, 1 - Math.floor(Math.log10(sigma / factor))));
  return `${fixed(value / factor, decimals)}\u00a0±\u00a0${fixed(sigma / factor, decimals)}\u00a0${prefix}${unit}`;
}

/**
 * Decimals that an increment needs to be told apart from its neighbours.
 * @param {number} increment
 * @returns {number} 0 to 9
 */
export function decimalsOf(increment) {
  for (let decimals = 0; decimals < 9; decimals += 1) {
    const scaled = increment * 10 ** decimals;
    if (Math.abs(scaled - Math.round(scaled)) < 1e-6 * Math.max(1, scaled) && scaled > 0.5) return decimals;
  }
  return 9;
}

const two = (/** @type {number} */ n) => String(n).padStart(2, "0");

/**
 * Time of day where the page is looked at: `20:14:05`.
 * @param {number} at_ms since 1970
 * @returns {string}
 */
export function clock(at_ms) {
  const d = new Date(at_ms);
  return `${two(d.getHours())}:${two(d.getMinutes())}:${two(d.getSeconds())}`;
}

/**
 * Date and time of day where the page is looked at: `2026-11-22 20:14:05`.
 * @param {number} at_ms since 1970
 * @returns {string}
 */
export function dateTime(at_ms) {
  const d = new Date(at_ms);
  return `${d.getFullYear()}-${two(d.getMonth() + 1)}-${two(d.getDate())} ${clock(at_ms)}`;
}

/**
 * Time of day, with the date before it where that is not today's.
 * @param {number} at_ms since 1970
 * @returns {string}
 */
export function moment(at_ms) {
  return new Date(at_ms).toDateString() === new Date().toDateString() ? clock(at_ms) : dateTime(at_ms);
}

/**
 * Date and time in UTC, for files: `2026-11-22T20:14:05.123Z`.
 * @param {number} at_ms since 1970
 * @returns {string}
 */
export function isoUtc(at_ms) {
  return new Date(at_ms).toISOString();
}

/**
 * A duration in its two largest units: `1 h 5 min`.
 * @param {number} seconds
 * @returns {string}
 */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return NOTHING;
  const s = Math.max(0, seconds);
  if (s < 10) return `${fixed(s, Number.isInteger(s) ? 0 : 1)}\u00a0s`;
  if (s < 59.5) return `${Math.round(s)}\u00a0s`;
  const minutes = Math.round(s / 60);
  if (s < 3570) return s < 600 && Math.round(s) % 60 ? `${Math.floor(Math.round(s) / 60)}\u00a0min ${Math.round(s) % 60}\u00a0s` : `${minutes}\u00a0min`;
  if (minutes < 24 * 60) return `${Math.floor(minutes / 60)}\u00a0h ${minutes % 60}\u00a0min`;
  const hours = Math.round(s / 3600);
  return `${Math.floor(hours / 24)}\u00a0d ${hours % 24}\u00a0h`;
}

/**
 * A size in bytes: `1.2 MB`.
 * @param {number} bytes
 * @returns {string}
 */
export function bytes(bytes) {
  return bytes < 1000 ? `${bytes}\u00a0B` : si(bytes, "B", 3);
}

/**
 * A word of the API in plain English: `waiting-for-pot`, `WaitingForPot` → `waiting for pot`.
 * @param {string} word
 * @returns {string}
 */
export function words(word) {
  return word.replace(/([a-z])([A-Z])/g, "$1 $2").replace(/[-_]/g, " ").toLowerCase();
}
