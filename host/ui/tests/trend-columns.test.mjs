// The past in columns: the store's, grown by the live stream, without holes, bounded.
import assert from "node:assert/strict";
import { test } from "node:test";
import { CAPACITY, TrendColumns } from "../page/js/live/trend-columns.js";

const envelope = (...values) => ({ min: values.map((v) => v - 1), mean: values, max: values.map((v) => v + 1) });
const history = (at_ms, power) => ({
  step_ms: 1000, at_ms, half_cycles: at_ms.map(() => 100), power_w: envelope(...power), r_ohm: envelope(...power.map(() => 4)), l_h: envelope(...power.map(() => 30e-6)),
  f_sw_hz: envelope(...power.map(() => 4e4)), i_crest_a: envelope(...power), phase_deg: power.map(() => 40), resonance_hz: power.map(() => 3e4), asked_w: power.map(() => 1000), state: [], pot: [], fault: [],
  results: { of: 0, at_ms: [], r_ohm: [], l_h: [], sigma_r_pct: [], sigma_l_pct: [], pass: [] },
});
const interval = (power, low = power, high = power, half_cycles = 20, f_sw_hz = 4e4) => ({
  half_cycles, skipped: 0, last: { power_w: power, f_sw_hz, r_ohm: 4, l_h: 30e-6, asked_w: 1000 }, phase_deg: 40, resonance_hz: 3e4, power_w: [low, high], r_ohm: [4, 4], l_h: [30e-6, 30e-6], f_sw_hz: [f_sw_hz, f_sw_hz],
});

test("live intervals go on the grid that the store began", () => {
  const columns = new TrendColumns();
  columns.load(history([10_250, 11_250, 12_250], [1, 2, 3]));
  for (let at = 12_400; at <= 14_900; at += 200) columns.append(at, interval(5));
  assert.deepEqual(columns.at_s, [10.25, 11.25, 12.25, 13.25, 14.25]);
});

test("a column keeps what was extreme in it, and a mean between", () => {
  const columns = new TrendColumns();
  columns.load(history([0], [1000]));
  columns.append(1000, interval(900, 850, 950));
  columns.append(1200, interval(1100, 1000, 1300, 60));
  const { min, mean, max } = columns.quantities.power_w;
  assert.deepEqual([min[1], max[1]], [850, 1300]);
  assert.equal(mean[1], (900 * 20 + 1100 * 60) / 80);
});

test("silence is a gap, of the store and of the stream", () => {
  const columns = new TrendColumns();
  columns.load(history([0, 1000, 9000], [1, 2, 3]));
  assert.deepEqual(columns.quantities.power_w.mean, [1, 2, null, 3]);
  columns.append(20_000, interval(5));
  assert.deepEqual(columns.quantities.power_w.mean.slice(-3), [3, null, 5]);
  for (let k = 1; k < columns.at_s.length; k += 1) assert.ok(columns.at_s[k] > columns.at_s[k - 1], "time goes on");
});

test("an inverter that is off has power but neither R nor L", () => {
  const columns = new TrendColumns();
  columns.append(0, interval(0, 0, 0, 20, 0));
  assert.equal(columns.quantities.power_w.mean[0], 0);
  assert.equal(columns.quantities.r_ohm.mean[0], null);
  assert.equal(columns.quantities.f_sw_hz.mean[0], null);
});

test("a day of telemetry stays bounded, and all lists equally long", () => {
  const columns = new TrendColumns();
  columns.live_ms = 200;
  for (let k = 0; k < 5 * CAPACITY; k += 1) columns.append(200 * k, interval(k % 1000));
  assert.ok(columns.at_s.length <= CAPACITY * 1.1 && columns.at_s.length >= CAPACITY, `${columns.at_s.length}`);
  for (const list of [columns.phase_deg, columns.asked_w, columns.resonance_hz, ...Object.values(columns.quantities).flatMap((q) => [q.min, q.mean, q.max])]) {
    assert.equal(list.length, columns.at_s.length);
  }
});

test("results come once, in order, and bounded", () => {
  const columns = new TrendColumns();
  for (let k = 0; k < 20_000; k += 1) columns.appendResult({ at_ms: 100 * k, r_ohm: 4, l_h: 30e-6, pass: k % 7 > 0 });
  columns.appendResult({ at_ms: 100 * 19_999, r_ohm: 9, l_h: 9, pass: true });
  const { results } = columns;
  assert.ok(results.at_s.length < 5000 && results.at_s.length === results.pass.length);
  assert.equal(results.r_ohm.at(-1), 4, "the same result twice is one");
});

test("the live stream may be finer than the store", () => {
  const columns = new TrendColumns();
  columns.load(history([10_000, 11_000], [1, 2]), 200);
  for (let at = 11_100; at <= 12_500; at += 100) columns.append(at, interval(5));
  assert.deepEqual(columns.at_s.slice(2), [11.2, 11.4, 11.6, 11.8, 12, 12.2, 12.4]);
});

test("numbers that were none leave no mark", () => {
  const columns = new TrendColumns();
  columns.append(0, interval(1000));
  columns.append(100, { ...interval(null, null, null), last: { power_w: null, f_sw_hz: 4e4, r_ohm: null, l_h: null, asked_w: 1000 }, r_ohm: [null, null] });
  assert.deepEqual([columns.quantities.power_w.min[0], columns.quantities.power_w.mean[0], columns.quantities.r_ohm.mean[0]], [1000, 1000, 4]);
});
