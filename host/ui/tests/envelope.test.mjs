import assert from "node:assert/strict";
import { test } from "node:test";

import { envelope } from "../page/js/live/envelope.js";

/** Least and largest of `columns` columns of a carrier of amplitude 1 with so many periods. */
function columnsOf(columns, periods, pairs = 9394) {
  const least = [];
  const largest = [];
  for (let c = 0; c < columns; c += 1) {
    const part = [];
    for (let k = Math.floor((c * pairs) / columns); k < Math.floor(((c + 1) * pairs) / columns); k += 1) part.push(Math.sin((2 * Math.PI * periods * k) / pairs));
    least.push(Math.min(...part));
    largest.push(Math.max(...part));
  }
  return [least, largest];
}

test("a carrier of constant amplitude has a flat envelope, however many columns", () => {
  for (const columns of [480, 550, 700, 900, 1200, 1500, 1800]) {
    const [least, largest] = envelope(...columnsOf(columns, 462), 462);
    // 20 pairs a period miss the crest by at most 1 - cos(2π/40).
    assert.ok(Math.min(...largest) > 0.98, `${columns}: ${Math.min(...largest)}`);
    assert.ok(Math.max(...least) < -0.98, `${columns}: ${Math.max(...least)}`);
  }
});

test("without it the columns beat with the carrier", () => {
  const [, largest] = columnsOf(900, 462);
  assert.ok(Math.min(...largest) < 0.5);
});

test("a wave that is wide enough to be seen stays one, and so does what holds whole periods", () => {
  const wave = columnsOf(1200, 100);
  assert.deepEqual(envelope(...wave, 100), wave);
  const whole = columnsOf(400, 462);
  assert.deepEqual(envelope(...whole, 462), whole);
});
