// Numbers as people read them: SI prefixes, units, durations.
import assert from "node:assert/strict";
import { test } from "node:test";
import { decimalsOf, duration, fixed, isoUtc, prefixOf, si, significant, watt, withSigma, words } from "../page/js/format.js";

const plain = (text) => text.replaceAll("\u00a0", " ");

test("prefixes leave one to three digits before the point", () => {
  for (const [value, unit, digits, text] of [
    [28.9e-6, "H", 3, "28.9 µH"], [4.7123, "Ω", 4, "4.712 Ω"], [0.0123, "Ω", 3, "12.3 mΩ"], [38_171, "Hz", 4, "38.17 kHz"],
    [1.08e-6, "F", 3, "1.08 µF"], [775_188, "S/s", 3, "775 kS/s"], [0, "A", 3, "0 A"], [-33.98, "A", 3, "\u221234.0 A"],
    [1e-15, "F", 3, "0.00100 pF"], [2.5e10, "Hz", 3, "25.0 GHz"],
  ]) assert.equal(plain(si(value, unit, digits)), text);
});

test("rounding over a decade takes the next prefix", () => {
  assert.equal(plain(si(999.96, "Hz", 4)), "1.000 kHz");
  assert.equal(plain(si(0.99996, "Ω", 4)), "1.000 Ω");
  assert.deepEqual(prefixOf(999.4, 3), [1, ""]);
});

test("what is not known is a dash, never NaN", () => {
  for (const value of [null, undefined, NaN, Infinity, -Infinity]) {
    assert.equal(si(value, "V"), "–");
    assert.equal(fixed(value, 2), "–");
    assert.equal(watt(value), "–");
  }
});

test("minus is a minus sign, and a zero has none", () => {
  assert.equal(fixed(-1.5, 1), "\u22121.5");
  assert.equal(fixed(-0.004, 2), "0.00");
  assert.equal(significant(-0, 3), "0");
});

test("the standard deviation decides the digits", () => {
  assert.equal(plain(withSigma(4.71234, 0.0123, "Ω")), "4.712 ± 0.012 Ω");
  assert.equal(plain(withSigma(28.9123e-6, 0.34e-6, "H")), "28.91 ± 0.34 µH");
  assert.equal(plain(withSigma(4.71234, null, "Ω")), "4.712 Ω");
});

test("decimals tell neighbours on an axis apart", () => {
  for (const [increment, decimals] of [[1, 0], [5, 0], [20, 0], [0.5, 1], [0.25, 2], [0.1, 1], [0.002, 3], [2.5, 1], [1000, 0]]) {
    assert.equal(decimalsOf(increment), decimals, `increment ${increment}`);
  }
});

test("durations in their two largest units", () => {
  for (const [s, text] of [[0, "0 s"], [3, "3 s"], [3.25, "3.3 s"], [42, "42 s"], [59.7, "1 min"], [65, "1 min 5 s"], [300, "5 min"], [754, "13 min"],
    [3600, "1 h 0 min"], [3900, "1 h 5 min"], [90_000, "1 d 1 h"]]) assert.equal(plain(duration(s)), text, `${s} s`);
});

test("times in files are UTC", () => assert.equal(isoUtc(1_795_377_871_285), "2026-11-22T20:04:31.285Z"));

test("words of the API become English", () => {
  assert.equal(words("waiting-for-pot"), "waiting for pot");
  assert.equal(words("WaitingForPot"), "waiting for pot");
});
