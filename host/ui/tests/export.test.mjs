// Files for spreadsheets: fields, names, axes' words.
import assert from "node:assert/strict";
import { test } from "node:test";
import { axisValues, timeValues } from "../page/js/axes.js";
import { csv, csvField, fileName } from "../page/js/export.js";
import { tableOf } from "../page/js/plot-table.js";
import { powersOf } from "../page/js/live/acts.js";
import { hashOf, placeOf } from "../page/js/router.js";

test("fields are quoted as RFC 4180 says, and no text is a formula", () => {
  for (const [value, field] of [["a,b", '"a,b"'], ['say "x"', '"say ""x"""'], ["two\nlines", '"two\nlines"'], ["=1+1", "'=1+1"], ["@x", "'@x"], ["-a", "'-a"],
    [-1.5, "-1.5"], [1e-9, "1e-9"], [NaN, ""], [null, ""], [undefined, ""], [true, "true"]]) assert.equal(csvField(value), field);
});

test("remarks stay one line each", () => {
  assert.equal(csv(["a\r\nb"], ["t / s"], [[1], [2]]), "# a b\r\nt / s\r\n1\r\n2\r\n");
});

test("names of files hold nothing that a path would", () => {
  assert.equal(fileName(["../../etc", "r of t"], Date.UTC(2026, 10, 22, 20, 4, 31), "csv"), "etc-r-of-t-20261122T200431Z.csv");
});

test("numbers of an axis are in its unit, as many decimals as tell them apart", () => {
  assert.deepEqual(axisValues(1e6)(null, [28e-6, 28.5e-6, null], 0, 0, 0.5e-6), ["28.0", "28.5", ""]);
  assert.deepEqual(axisValues(1e-3)(null, [40_000, 60_000], 0, 0, 20_000), ["40", "60"]);
});

test("times of an axis say as much as their distance needs", () => {
  const noon = new Date(2026, 10, 22, 12, 0, 5, 200).getTime() / 1000;
  assert.deepEqual(timeValues(null, [noon], 0, 0, 60), ["12:00"]);
  assert.deepEqual(timeValues(null, [noon], 0, 0, 5), ["12:00:05"]);
  assert.deepEqual(timeValues(null, [noon], 0, 0, 86_400), ["11-22"]);
});

test("powers of a sweep", () => {
  assert.deepEqual(powersOf("400, 900;1200", 2500), [400, 900, 1200]);
  for (const bad of ["", "0", "-5", "400, x", "2501", "1.5"]) assert.equal(powersOf(bad, 2500), null, bad);
});

test("places go through the hash and back, and nonsense is the list of devices", () => {
  assert.deepEqual(placeOf(hashOf("live", "tcp:127.0.0.1:4711")), { view: "live", device: "tcp:127.0.0.1:4711" });
  for (const hash of ["", "#", "#/nowhere/x", "#/%ff"]) assert.equal(placeOf(hash).view, "devices");
  assert.equal(placeOf("#/live/%ff").device, "");
});

test("the table of a plot is what is seen, in the units of its axes", () => {
  const options = { x: { label: "t", unit: "ms", factor: 1e3 }, axes: [{ key: "l", label: "L", unit: "µH", factor: 1e6 }], series: [{ label: "network", axis: "l", colour: "s1" }] };
  const plot = { options, data: [[0, 1e-3, 2e-3, 3e-3], [30e-6, null, 31e-6, 32e-6]], seen: () => ({ from: 0.5e-3, to: 2e-3 }) };
  assert.deepEqual(tableOf(plot), { remarks: [], head: ["t / ms", "network / µH"], rows: [[1, null], [2, 31]] });
  const own = { ...plot, options: { ...options, table: () => ({ remarks: ["r"], head: ["t / s"], rows: [[0], [1e-3], [9]] }) } };
  assert.deepEqual(tableOf(own).rows, [[1e-3]]);
});
