import assert from "node:assert/strict";
import { test } from "node:test";
import { tickText, title } from "../page/js/map/words.js";
import { asMap, cellText, change, coordinate, differencePct, lowestAllowed, quantity, sameAxes, scaleOf, values } from "../page/js/map/values.js";

// The firmware's axes and its prior (shared/src/lookup/grid.rs, prior.rs): R(I) = 3 + 4 / (1 + I / 9 A), L(I) = 20.5 + 18 / (1 + I / 10 A) µH at
// 45 kHz, R with the square root of f, L with f^-0.3.
const f_sw_hz = Array.from({ length: 8 }, (_, k) => 30e3 * (80 / 30) ** (k / 7));
const i_a = Array.from({ length: 17 }, (_, k) => 5 * (17 ** (k / 16) - 1));
const grid = (of) => f_sw_hz.map((f) => i_a.map((i) => of(f, i)));
const prior = {
  version: 0,
  f_sw_hz,
  i_a,
  r_ohm: grid((f, i) => (3 + 4 / (1 + i / 9)) * (f / 45e3) ** 0.5),
  l_h: grid((f, i) => (20.5 + 18 / (1 + i / 10)) * 1e-6 * (f / 45e3) ** -0.3),
  power_w: grid((f, i) => ((3 + 4 / (1 + i / 9)) * (f / 45e3) ** 0.5 * i * i) / 2),
  observed: grid(() => false),
  sigma_r_pct: null,
  sigma_l_pct: null,
  confidence: null,
  age_s: grid(() => null),
};
const other = { ...prior, version: 4, r_ohm: prior.r_ohm.map((row, f) => row.map((r, i) => (f === 2 && i > 10 ? r * 0.95 : r))) };

test("a difference is what one has above the other, in percent of the other", () => {
  assert.equal(differencePct(5.25, 5), 5.000000000000004);
  assert.ok(Math.abs(differencePct(4, 5) + 20) < 1e-12);
  for (const pair of [[null, 5], [5, null], [5, 0], [NaN, 1], [Infinity, 1]]) assert.equal(differencePct(...pair), null);
});

test("a map differs from itself by nothing, and from another where that is changed", () => {
  assert.ok(values(prior, "r-difference", prior).flat().every((d) => d === 0));
  const d = values(other, "r-difference", prior);
  assert.ok(Math.abs(d[2][11] + 5) < 1e-9 && d[2][10] === 0 && d[3][11] === 0);
  assert.deepEqual(change(prior, other), { cells: 6, r_pct: d[2].slice(11).reduce((a, b) => (Math.abs(b) > Math.abs(a) ? b : a), 0), l_pct: 0 });
});

test("maps on other axes are not compared", () => {
  const shifted = { ...prior, i_a: i_a.map((i) => i * 1.1) };
  assert.equal(sameAxes(prior, shifted), false);
  assert.equal(sameAxes(prior, { ...prior, f_sw_hz: f_sw_hz.map((f) => f * 1.0001) }), true);
  assert.ok(values(prior, "l-difference", shifted).flat().every((d) => d === null));
});

test("what is not known has no value; ages grow while the map is looked at", () => {
  assert.ok(values(prior, "confidence").flat().every((v) => v === null));
  const aged = { ...prior, age_s: grid((_f, i) => (i > 20 ? 7 : null)) };
  assert.equal(values(aged, "age", null, 10)[0][16], 17);
  assert.equal(values(aged, "age", null, 10)[0][0], null);
  assert.equal(values({ ...prior, r_ohm: [] }, "r")[3][3], null, "a table that is too short breaks nothing");
});

test("what is no map is refused before anything is drawn", () => {
  assert.equal(asMap(prior), prior);
  for (const wrong of [null, {}, [], "map", { ...prior, l_h: [] }, { ...prior, observed: prior.observed.slice(1) }, { ...prior, i_a: [1] }, { ...prior, confidence: 1 }, { ...prior, sigma_l_pct: [[1]] }]) {
    assert.throws(() => asMap(wrong), /no map/);
  }
  const { sigma_r_pct, sigma_l_pct, ...before } = prior;
  assert.equal(asMap(before), before, "a daemon that tells no deviations yet");
  assert.deepEqual(values(before, "r-sigma").flat().filter((v) => v !== null), []);
  asMap({ ...prior, r_ohm: prior.r_ohm.map((row) => row.map(() => null)) });
});

test("a scale of differences has zero in its middle and holds the largest of either sign", () => {
  const scale = scaleOf(quantity("r-difference"), [[-8, 2], [null, 0]]);
  assert.deepEqual([scale.low, scale.high], [-8, 8]);
  assert.equal(scale.place(0), 0);
  assert.equal(scale.place(-8), -1);
  assert.ok(scale.ticks.includes(0));
});

test("a linear scale spans the values, a logarithmic one decades, and neither breaks where all are alike or none is known", () => {
  const linear = scaleOf(quantity("r"), [[2, 6]]);
  assert.deepEqual([linear.place(2), linear.place(6), linear.place(4)], [0, 1, 0.5]);
  assert.deepEqual(linear.ticks, [2, 3, 4, 5, 6]);
  const log = scaleOf(quantity("power"), [[0, 1, 10_000]]);
  assert.ok(Math.abs(log.place(100) - 0.5) < 1e-9);
  assert.equal(log.place(0), 0);
  assert.deepEqual(log.ticks.map(Math.round), [1, 10, 100, 1000, 10_000]);
  for (const id of ["r", "power", "r-sigma", "age", "r-difference", "confidence"]) {
    for (const cells of [[[5, 5]], [[null, null]], [[0, 0]]]) {
      const scale = scaleOf(quantity(id), cells);
      for (const value of cells.flat()) assert.ok(value === null || Number.isFinite(scale.place(value)), `${id} ${value}`);
      assert.ok(scale.high > scale.low && scale.ticks.every(Number.isFinite), id);
      assert.equal(scale.empty, cells[0][0] === null);
    }
  }
});

test("knots lie on whole numbers, what is between them between, what is beyond half a cell out", () => {
  f_sw_hz.forEach((f, k) => assert.ok(Math.abs(coordinate(f_sw_hz, f, true) - k) < 1e-9));
  i_a.forEach((i, k) => assert.ok(Math.abs(coordinate(i_a, i, false) - k) < 1e-9));
  assert.ok(Math.abs(coordinate(f_sw_hz, Math.sqrt(f_sw_hz[3] * f_sw_hz[4]), true) - 3.5) < 1e-9);
  assert.equal(coordinate(f_sw_hz, 200e3, true), 7.5);
  assert.equal(coordinate(i_a, -90, false), -0.5);
});

test("the lowest allowed frequency is the margin above the resonance with the L that the map has there", () => {
  const hob = { resonance_capacitance_f: 0.66e-6, resonance_margin: 1.05 };
  const lowest = lowestAllowed(prior, hob);
  const known = lowest.map((f, k) => [f, k]).filter(([f]) => f !== null);
  assert.ok(known.length > 3);
  for (const [f, k] of known) {
    // The oracle: the prior's own law, of which the map is an interpolation (0.3 %).
    const l = (20.5 + 18 / (1 + i_a[k] / 10)) * 1e-6 * (f / 45e3) ** -0.3;
    const resonance = 1 / (2 * Math.PI * Math.sqrt(l * hob.resonance_capacitance_f));
    assert.ok(Math.abs(f / (1.05 * resonance) - 1) < 0.003, `${f} against ${1.05 * resonance}`);
  }
  const l40 = 24.1e-6;
  const whole = lowestAllowed({ ...prior, l_h: grid(() => l40) }, { resonance_capacitance_f: 1e-6, resonance_margin: 1 });
  for (const f of whole) assert.ok(Math.abs(f - 1 / (2 * Math.PI * Math.sqrt(l40 * 1e-6))) < 1);
});

test("numbers of cells have three digits and one prefix for all", () => {
  const scale = scaleOf(quantity("l"), prior.l_h);
  assert.equal(cellText(quantity("l"), 28.93e-6, scale), "28.9");
  assert.equal(cellText(quantity("r"), 5.4321, scaleOf(quantity("r"), prior.r_ohm)), "5.43");
  const power = scaleOf(quantity("power"), prior.power_w);
  assert.deepEqual([0, 0.43, 12.4, 999.6, 11_900].map((p) => cellText(quantity("power"), p, power)), ["0", "430m", "12", "1k", "12k"]);
  const pct = scaleOf(quantity("r-difference"), [[-3, 3]]);
  assert.deepEqual([-2.04, 0.01, 1.96, 240].map((d) => cellText(quantity("r-difference"), d, pct)), ["\u22122.0", "0", "+2.0", "+240"]);
  const sigma = scaleOf(quantity("r-sigma"), [[0.04, 45]]);
  assert.deepEqual([0, 0.04, 0.996, 4.21, 9.96, 42.4, 655.35].map((s) => cellText(quantity("r-sigma"), s, sigma)), ["0", "0.04", "1.0", "4.2", "10", "42", "655"]);
  assert.deepEqual([title(quantity("r-sigma"), sigma), ...sigma.ticks.map((tick) => tickText(quantity("r-sigma"), tick, sigma))], ["σ of R / %", "0.1", "0.3", "1", "3", "10", "30"]);
  assert.equal(cellText(quantity("age"), null, scale), "–");
  assert.deepEqual([45, 720, 10_800, 700_000].map((s) => cellText(quantity("age"), s, scale)), ["45s", "12m", "3h", "8d"]);
});
