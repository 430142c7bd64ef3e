// How much warmer the pot is: words and curve.
import assert from "node:assert/strict";
import { test } from "node:test";

import { outline, potWords } from "../page/js/live/pot-temperature.js";

const now = { since_ms: 0, rise_k: 40, sigma_k: 5, prior_k: 60, prior_sigma_k: 30, lift_mm: 0.1, lift_sigma_mm: 0.05, bubbles: false, boils: false, overheats: false };

test("what is known is said, and nothing where nothing is", () => {
  assert.match(potWords(null), /not known/);
  assert.match(potWords(now), /by its heat alone \+60 ± 30/);
  assert.doesNotMatch(potWords(now), /boils|bubbles|overheats/);
  assert.match(potWords({ ...now, bubbles: true }), /bubbles at its base/);
  const boils = potWords({ ...now, bubbles: true, boils: true });
  assert.match(boils, /boils/);
  assert.doesNotMatch(boils, /bubbles/);
  assert.match(potWords({ ...now, overheats: true }), /overheats/);
});

test("the curve lies within its band and the drawing", () => {
  assert.deepEqual(outline([]), { band: "", line: "", label: "" });
  const points = [0, 1, 2, 3].map((k) => ({ at_ms: 60_000 * k, rise_k: 30 * k, sigma_k: 1 + 3 * k }));
  const { band, line, label } = outline(points);
  const pairs = (text) => text.split(" ").map((p) => p.split(",").map(Number));
  assert.equal(pairs(line).length, 4);
  assert.equal(pairs(band).length, 8);
  for (const [x, y] of [...pairs(line), ...pairs(band)]) assert.ok(x >= 0 && x <= 300 && y >= 0 && y <= 90, `${x} ${y}`);
  pairs(line).forEach(([, y], k) => {
    assert.ok(pairs(band)[k][1] <= y && pairs(band)[7 - k][1] >= y);
  });
  assert.equal(label, "0 to 100\u00a0K over 3.0\u00a0min, band ± σ");
});

test("noise of a kelvin is no mountain", () => {
  const points = [0, 1, 2].map((k) => ({ at_ms: 2_000 * k, rise_k: (-1) ** k * 0.5, sigma_k: 0.5 }));
  const heights = outline(points).line.split(" ").map((p) => Number(p.split(",")[1]));
  assert.ok(Math.max(...heights) - Math.min(...heights) < 9);
});
