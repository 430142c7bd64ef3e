import assert from "node:assert/strict";
import { test } from "node:test";
import { aboveZero, decades, reason, verdicts, withNewest } from "../page/js/training/fits.js";

const fit = (seq, more = {}) => ({ boot: 1, seq, at_ms: 1000 * seq, pass: true, why: "", remarks: [], ...more });

test("new fits come before old ones, each once, and a hole is seen", () => {
  const list = [5, 4, 3].map((seq) => fit(seq));
  const joined = withNewest(list, [7, 6, 5].map((seq) => fit(seq)), 4);
  assert.deepEqual(joined.list.map((f) => f.seq), [7, 6, 5, 4]);
  assert.equal(joined.hole, false);
  assert.equal(withNewest(list, [9, 8, 7].map((seq) => fit(seq)), 10).hole, true);
  assert.equal(withNewest([], [fit(9)], 10).hole, false);
  assert.equal(withNewest(list, [], 10).hole, false);
});

test("windows of two boots with one number are two fits", () => {
  const { list } = withNewest([fit(5)], [{ ...fit(5), boot: 2, at_ms: 9000 }, fit(5)], 10);
  assert.equal(list.length, 2);
});

test("a fit that was read again shows what is known of it now", () => {
  const { list } = withNewest([fit(5)], [fit(5, { changed_lookup: true })], 10);
  assert.equal(list[0].changed_lookup, true);
});

test("refusals are counted by reason, whatever numbers stand in them", () => {
  const refused = (why, remarks = []) => fit(1, { pass: false, why, remarks });
  const fits = [
    refused("sigma of R is 3.1 %, more than 2 %"),
    refused("sigma of R is 12.45 %, more than 2 %"),
    refused("a tone of 8.0 V", [{ code: "interference", severity: "error", text: "" }]),
    refused("a tone of 9 V", [{ code: "noisy", severity: "info", text: "" }, { code: "interference", severity: "error", text: "" }]),
    refused("a tone of 7 V", [{ code: "interference", severity: "error", text: "" }]),
    refused(""),
    fit(2),
  ];
  const { passed, refused: count, reasons } = verdicts(fits);
  assert.deepEqual([passed, count], [1, 6]);
  assert.deepEqual(reasons.map((r) => r.count), [3, 2, 1]);
  assert.equal(reasons[0].reason, "interference");
  assert.equal(reason(refused("")), "no reason given");
  assert.equal(reason(fit(2)), "");
});

test("a logarithmic axis gets no zero, no negative and no nothing", () => {
  assert.deepEqual([1e-9, 0, -1, NaN, null, undefined, Infinity].map(aboveZero), [1e-9, null, null, null, null, null, null]);
});

test("a logarithmic axis spans whole decades, one at least", () => {
  assert.deepEqual(decades(0.0023, 0.0024), [0.001, 0.01]);
  assert.deepEqual(decades(1e-5, 3), [1e-5, 10]);
  assert.deepEqual(decades(1, 1), [1, 10]);
  assert.deepEqual(decades(null, null), [0.1, 10]);
});
