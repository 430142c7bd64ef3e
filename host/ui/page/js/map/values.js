// @ts-check
/** What a lookup's cells say: quantities of the map, differences, and what the controller's limits mean on its axes. */

/**
 * A lookup as `/devices/NAME/map` tells it; tables are [frequency][current].
 * @typedef {object} LookupMap
 * @property {number} version
 * @property {string} state
 * @property {number} at_ms
 * @property {string} origin
 * @property {string} why
 * @property {number[]} f_sw_hz
 * @property {number[]} i_a
 * @property {number[][]} r_ohm
 * @property {number[][]} l_h
 * @property {number[][]} power_w
 * @property {boolean[][]} observed
 * @property {number[][] | null} [sigma_r_pct] of a daemon that tells it
 * @property {number[][] | null} [sigma_l_pct]
 * @property {number[][] | null} confidence
 * @property {(number | null)[][]} age_s
 */

/** @typedef {"r" | "l" | "power" | "r-sigma" | "l-sigma" | "age" | "confidence" | "r-difference" | "l-difference"} QuantityId */

/**
 * @typedef {object} Quantity
 * @property {QuantityId} id
 * @property {string} name for people
 * @property {string} column its column in a CSV file, with its unit
 * @property {string} unit SI unit without prefix; "%" for percent, "" for none
 * @property {"linear" | "log" | "diverging" | "unit"} scale
 * @property {"cividis" | "viridis" | "diverging"} colours
 */

/** @type {Quantity[]} */
export const QUANTITIES = [
  { id: "r", name: "R", column: "r_ohm", unit: "Ω", scale: "linear", colours: "viridis" },
  { id: "l", name: "L", column: "l_h", unit: "H", scale: "linear", colours: "viridis" },
  { id: "power", name: "Power", column: "power_w", unit: "W", scale: "log", colours: "cividis" },
  { id: "r-sigma", name: "σ of R", column: "sigma_r_pct", unit: "%", scale: "log", colours: "cividis" },
  { id: "l-sigma", name: "σ of L", column: "sigma_l_pct", unit: "%", scale: "log", colours: "cividis" },
  { id: "age", name: "Age", column: "age_s", unit: "s", scale: "log", colours: "cividis" },
  { id: "confidence", name: "Confidence", column: "confidence", unit: "", scale: "unit", colours: "cividis" },
  { id: "r-difference", name: "R, difference", column: "r_difference_pct", unit: "%", scale: "diverging", colours: "diverging" },
  { id: "l-difference", name: "L, difference", column: "l_difference_pct", unit: "%", scale: "diverging", colours: "diverging" },
];

/** @param {string} id @returns {Quantity} the first where nobody knows the id */
export const quantity = (id) => QUANTITIES.find((q) => q.id === id) ?? QUANTITIES[0];

/**
 * A map as the daemon answered, where it is one.
 * @param {any} answer
 * @returns {LookupMap}
 */
export function asMap(answer) {
  const list = (/** @type {any} */ of, least = 2) => Array.isArray(of) && of.length >= least;
  const table = (/** @type {any} */ of) =>
    list(of) && of.length === answer.f_sw_hz.length && of.every((/** @type {any} */ row) => list(row) && row.length === answer.i_a.length);
  const fits =
    Number.isInteger(answer?.version) &&
    list(answer.f_sw_hz) &&
    list(answer.i_a) &&
    [answer.r_ohm, answer.l_h, answer.power_w, answer.observed, answer.age_s].every(table) &&
    [answer.confidence, answer.sigma_r_pct ?? null, answer.sigma_l_pct ?? null].every((of) => of === null || table(of));
  if (!fits) throw new Error("the daemon's answer is no map; reload the page, which may be of another version than the daemon");
  return answer;
}

/** Marks of a colour bar: seconds to months, percent, and powers of ten. */
const AGES_S = [0.1, 1, 10, 60, 600, 3600, 6 * 3600, 86_400, 7 * 86_400, 30 * 86_400, 365 * 86_400];
const PERCENTS = [0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100, 300];
const DECADES = Array.from({ length: 25 }, (_, k) => Number(`1e${k - 12}`));

/** Whether two maps lie on the same axes. @param {LookupMap} a @param {LookupMap} b */
export function sameAxes(a, b) {
  const same = (/** @type {number[]} */ x, /** @type {number[]} */ y) =>
    x.length === y.length && x.every((value, k) => Math.abs(value - y[k]) <= 1e-3 * Math.max(Math.abs(value), 1e-3));
  return same(a.f_sw_hz, b.f_sw_hz) && same(a.i_a, b.i_a);
}

/** How far a value lies above a reference, in percent of the reference; null where there is none. */
export function differencePct(/** @type {number | null | undefined} */ value, /** @type {number | null | undefined} */ reference) {
  if (!Number.isFinite(value) || !Number.isFinite(reference) || reference === 0) return null;
  return (Number(value) / Number(reference) - 1) * 100;
}

/**
 * A quantity of every cell, in SI units or percent; null where it is not known.
 * @param {LookupMap} map
 * @param {QuantityId} id
 * @param {LookupMap | null} reference for differences
 * @param {number} olderBy_s seconds since the map was read, by which ages have grown
 * @returns {(number | null)[][]}
 */
export function values(map, id, reference = null, olderBy_s = 0) {
  const known = (/** @type {number | null | undefined} */ value) => (Number.isFinite(value) ? Number(value) : null);
  const table = (/** @type {(number | null)[][] | null | undefined} */ of) =>
    map.f_sw_hz.map((_, f) => map.i_a.map((_, i) => known(of?.[f]?.[i])));
  const against = (/** @type {"r_ohm" | "l_h"} */ key) =>
    reference && sameAxes(map, reference)
      ? map[key].map((row, f) => row.map((value, i) => differencePct(value, reference[key][f]?.[i])))
      : table(null);
  switch (id) {
    case "r":
      return table(map.r_ohm);
    case "l":
      return table(map.l_h);
    case "power":
      return table(map.power_w);
    case "confidence":
      return table(map.confidence);
    case "r-sigma":
      return table(map.sigma_r_pct);
    case "l-sigma":
      return table(map.sigma_l_pct);
    case "age":
      return table(map.age_s).map((row) => row.map((age) => (age === null ? null : age + olderBy_s)));
    case "r-difference":
      return against("r_ohm");
    default:
      return against("l_h");
  }
}

/**
 * The scale of a colour bar.
 * @typedef {object} Scale
 * @property {number} low
 * @property {number} high
 * @property {(value: number) => number} place 0 to 1 along the bar; of a diverging one -1 to 1
 * @property {number[]} ticks
 * @property {boolean} empty whether no cell has a value
 */

/**
 * A scale that holds every value. A diverging one has zero in its middle; a logarithmic one spans six decades at most.
 * @param {Quantity} of
 * @param {(number | null)[][]} cells
 * @returns {Scale}
 */
export function scaleOf(of, cells) {
  const all = /** @type {number[]} */ (cells.flat().filter((value) => value !== null));
  const empty = all.length === 0;
  const largest = empty ? 1 : Math.max(...all);
  if (of.scale === "unit") return { low: 0, high: 1, place: (v) => v, ticks: [0, 0.25, 0.5, 0.75, 1], empty };
  if (of.scale === "diverging") {
    const end = Math.max(...all.map(Math.abs), 0) || 1;
    const ticks = linearTicks(-end, end, 5);
    return { low: -end, high: end, place: (v) => v / end, ticks, empty };
  }
  if (of.scale === "log") {
    const positive = all.filter((value) => value > 0);
    const high = positive.length === 0 ? 1 : Math.max(...positive);
    let low = positive.length === 0 ? 0.1 : Math.max(Math.min(...positive), high * 1e-6);
    if (high / low < 1.01) low = high / 10;
    const ratio = Math.log(high / low);
    const marks = of.unit === "s" ? AGES_S : of.unit === "%" ? PERCENTS : DECADES;
    const ticks = marks.filter((tick) => tick >= low * 0.999999 && tick <= high * 1.000001);
    if (ticks.length < 2) ticks.splice(0, ticks.length, low, high);
    return { low, high, place: (v) => (v <= 0 ? 0 : Math.min(Math.max(Math.log(v / low) / ratio, 0), 1)), ticks, empty };
  }
  let low = empty ? 0 : Math.min(...all);
  let high = largest;
  if (high - low < 1e-9 * Math.max(Math.abs(high), 1e-12)) [low, high] = [low - (Math.abs(low) * 0.01 || 1), high + (Math.abs(high) * 0.01 || 1)];
  return { low, high, place: (v) => (v - low) / (high - low), ticks: linearTicks(low, high, 5), empty };
}

/** Round numbers between two ends, about so many. @param {number} low @param {number} high @param {number} about */
export function linearTicks(low, high, about) {
  const raw = (high - low) / about;
  const decade = 10 ** Math.floor(Math.log10(raw));
  const step = decade * ([1, 2, 5, 10].find((m) => m * decade >= raw * 0.999) ?? 10);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k++) ticks.push(k === 0 ? 0 : k * step);
  return ticks;
}

/**
 * Where a value lies on an axis of knots: 0 at the first, 1 at the second; beyond the ends it stays there, half a
 * cell out at most.
 * @param {number[]} knots ascending
 * @param {number} value
 * @param {boolean} logarithmic
 */
export function coordinate(knots, value, logarithmic) {
  const of = (/** @type {number} */ x) => (logarithmic ? Math.log(Math.max(x, 1e-12)) : x);
  const last = knots.length - 1;
  let k = knots.findIndex((knot) => knot > value) - 1;
  if (k === -2) k = last - 1; // None is larger.
  k = Math.min(Math.max(k, 0), last - 1);
  const at = k + (of(value) - of(knots[k])) / (of(knots[k + 1]) - of(knots[k]));
  return Math.min(Math.max(at, -0.5), last + 0.5);
}

/** L at a frequency and a current, straight lines between the cells. @param {LookupMap} map @returns {number} henry */
export function inductanceAt(map, /** @type {number} */ f_sw_hz, /** @type {number} */ column) {
  const at = Math.min(Math.max(coordinate(map.f_sw_hz, f_sw_hz, true), 0), map.f_sw_hz.length - 1);
  const f = Math.min(Math.floor(at), map.f_sw_hz.length - 2);
  return map.l_h[f][column] * (1 - (at - f)) + map.l_h[f + 1][column] * (at - f);
}

/**
 * The lowest frequency at which the controller may run by this map, of each current: so far above the resonance with
 * the L that the map has there. Null where all of the map's range is allowed, or none of it.
 * @param {LookupMap} map
 * @param {{resonance_capacitance_f: number, resonance_margin: number}} hob
 * @returns {(number | null)[]} hertz
 */
export function lowestAllowed(map, hob) {
  const [low, high] = [map.f_sw_hz[0], map.f_sw_hz[map.f_sw_hz.length - 1]];
  return map.i_a.map((_, column) => {
    const above = (/** @type {number} */ f) =>
      f - hob.resonance_margin / (2 * Math.PI * Math.sqrt(inductanceAt(map, f, column) * hob.resonance_capacitance_f));
    if (!(above(low) < 0) || !(above(high) > 0)) return null;
    let [a, b] = [low, high];
    for (let k = 0; k < 40; k++) {
      const middle = (a + b) / 2;
      if (above(middle) < 0) a = middle;
      else b = middle;
    }
    return (a + b) / 2;
  });
}

/** Cells that rest on observations. @param {LookupMap} map @returns {number} */
export const observedCells = (map) => map.observed.flat().filter(Boolean).length;

/**
 * What a change from one map to another does, for people who are about to make it.
 * @param {LookupMap} from
 * @param {LookupMap} to
 * @returns {{cells: number, r_pct: number, l_pct: number}} cells that differ by 0.1 % or more, largest changes of R and L
 */
export function change(from, to) {
  const [r, l] = [values(to, "r-difference", from).flat(), values(to, "l-difference", from).flat()];
  const largest = (/** @type {(number | null)[]} */ of) =>
    of.reduce((/** @type {number} */ a, b) => (b !== null && Math.abs(b) > Math.abs(a) ? b : a), 0);
  const cells = r.filter((value, k) => Math.abs(value ?? 0) >= 0.1 || Math.abs(l[k] ?? 0) >= 0.1).length;
  return { cells, r_pct: largest(r), l_pct: largest(l) };
}

const PREFIXES = /** @type {[number, string][]} */ ([[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]]);

/**
 * The prefix of SI in which a scale's numbers are written, all alike.
 * @param {Quantity} of
 * @param {Scale} scale
 * @returns {[number, string]} factor and prefix
 */
export function prefixOf(of, scale) {
  if (of.scale !== "linear") return [1, ""];
  const size = Math.max(Math.abs(scale.low), Math.abs(scale.high));
  return PREFIXES.find(([factor]) => size >= factor) ?? [1, ""];
}

/**
 * A number that fits a cell: three digits; the unit stands at the colour bar, prefixes of a logarithmic scale here.
 * @param {Quantity} of
 * @param {number | null} value
 * @param {Scale} scale
 * @returns {string}
 */
export function cellText(of, value, scale) {
  if (value === null) return "–";
  const minus = (/** @type {string} */ text) => text.replace("-", "\u2212");
  if (of.id === "age") return shortAge(value);
  if (of.scale === "unit") return value.toFixed(2);
  if (of.scale === "diverging") {
    const text = value.toFixed(Math.abs(value) < 99.5 ? 1 : 0);
    if (Number(text) === 0) return "0";
    return minus(value > 0 ? `+${text}` : text);
  }
  if (of.scale === "log") {
    if (value === 0) return "0";
    if (of.unit === "%") return shortPercent(value);
    const size = Math.abs(Number(value.toPrecision(2)));
    const [factor, prefix] = PREFIXES.find(([f]) => size >= f) ?? [1e-9, "n"];
    const scaled = Number((value / factor).toPrecision(2));
    return minus(`${scaled}${prefix}`);
  }
  const scaled = value / prefixOf(of, scale)[0];
  return minus(scaled.toPrecision(3).includes("e") ? scaled.toFixed(0) : scaled.toPrecision(3));
}

/** Percent in at most four characters: `0.04`, `4.2`, `42`. @param {number} value */
const shortPercent = (value) => value.toFixed(value < 0.995 ? 2 : value < 9.95 ? 1 : 0);

/** Seconds in at most four characters: `45s`, `12m`, `3h`, `8d`. @param {number} seconds */
function shortAge(seconds) {
  if (seconds < 99.5) return `${Math.round(seconds)}s`;
  if (seconds < 99.5 * 60) return `${Math.round(seconds / 60)}m`;
  if (seconds < 47.5 * 3600) return `${Math.round(seconds / 3600)}h`;
  return `${Math.round(seconds / 86_400)}d`;
}
