// From a window of the API to what is drawn.
import assert from "node:assert/strict";
import { test } from "node:test";
import { loadData, scopeData, scopeTable } from "../page/js/live/scope-data.js";

const scope = {
  boot: 7, seq: 3, f_sw_hz: 40_000, sample_rate_hz: 813_333, decimated: true, t_s: [1, 3, 5], v_min_v: [-10, -20, -30], v_max_v: [10, 20, 30], i_min_a: [-1, -2, -3], i_max_a: [1, 2, 3],
  ekf: { t_s: [0, 2], r_ohm: [4, 5], l_h: [30e-6, 31e-6], r_sigma_ohm: [], l_sigma_h: [] }, network: null, truth: null,
};

test("a column of several pairs is a stroke from its least to its largest, in the order of time", () => {
  const [t, v, i] = scopeData(scope);
  assert.deepEqual(v, [-10, 10, -20, 20, -30, 30]);
  assert.deepEqual(i, [-1, 1, -2, 2, -3, 3]);
  for (let k = 1; k < t.length; k += 1) assert.ok(t[k] > t[k - 1]);
  assert.ok(t[0] > 0 && t[1] < 2, "each stroke within its column");
});

test("where each pair is a column the samples are drawn as they are", () => {
  assert.deepEqual(scopeData({ ...scope, decimated: false, v_max_v: [1, 2, 3] }), [[1, 3, 5], [1, 2, 3], [1, 2, 3]]);
});

test("the table keeps least and largest apart", () => {
  assert.deepEqual(scopeTable(scope).rows[1], [3, -20, 20, -2, 2]);
});

test("filter, network and truth share an axis of time though each has its own instants", () => {
  const network = { t_s: [0, 1], r_ohm: [4, 4.5], l_h: [30e-6, 30e-6], r_sigma_ohm: [0.1, 0.2], l_sigma_h: [1e-6, 1e-6] };
  const [t, filter, mean, high, low, truth] = loadData({ ...scope, network, truth: { t_s: [2], r_ohm: [4.9], l_h: [31e-6] } }, "R");
  assert.deepEqual(t, [0, 1, 2]);
  assert.deepEqual([filter[0], filter[2], mean[1], truth[2]], [4, 5, 4.5, 4.9]);
  assert.deepEqual([high[0], low[0], high[1], low[1]], [4.2, 3.8, 4.9, 4.1]);
});

test("without network, truth or sigma there is nothing in their place", () => {
  const data = loadData(scope, "L");
  assert.equal(data.length, 6);
  assert.deepEqual(data[1], [30e-6, 31e-6]);
  const bare = loadData({ ...scope, network: { t_s: [0], r_ohm: [4], l_h: [3e-5], r_sigma_ohm: [], l_sigma_h: [] } }, "R");
  assert.deepEqual([bare[3][0], bare[4][0]], [4, 4], "a band of no width");
});
