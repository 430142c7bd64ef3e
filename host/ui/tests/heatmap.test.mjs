import assert from "node:assert/strict";
import { test } from "node:test";
import { cividis, contrast, diverging, viridis } from "../page/js/colour.js";
import { colourOf, hatchOn, pieces } from "../page/js/heatmap.js";
import { quantity, scaleOf } from "../page/js/map/values.js";

test("a curve is drawn where it is known, and a single point is no curve", () => {
  const curve = pieces([0, 1, 2, 3, 4, 5, 6], [null, 30e3, 31e3, null, 32e3, null, 33e3]);
  assert.deepEqual(curve, [[{ f_sw_hz: 30e3, i_a: 1 }, { f_sw_hz: 31e3, i_a: 2 }]]);
  assert.deepEqual(pieces([0, 1], [null, null]), []);
});

test("the largest value has the end of its map's colours, zero of a difference the middle, nothing no colour", () => {
  const picture = (id, values) => ({ quantity: quantity(id), values, scale: scaleOf(quantity(id), values) });
  assert.deepEqual(colourOf(picture("r", [[2, 8]]), 8, false), viridis(1));
  assert.deepEqual(colourOf(picture("confidence", [[0.2]]), 1, false), cividis(1));
  assert.deepEqual(colourOf(picture("l-difference", [[-3, 1]]), 0, true), diverging(0, true));
  assert.deepEqual(colourOf(picture("l-difference", [[-3, 1]]), -3, false), diverging(-1, false));
  assert.equal(colourOf(picture("r", [[2, 8]]), null, false), null);
});

test("hatching is seen on every colour, and the number on it stays readable", () => {
  const strokes = { light: [255, 0.34], dark: [0, 0.42], faint: [0, 0.17] };
  for (let k = -50; k <= 50; k++) {
    for (const colour of [cividis(Math.abs(k) / 50), viridis(Math.abs(k) / 50), diverging(k / 50), diverging(k / 50, true)]) {
      const kind = hatchOn(colour);
      const [grey, alpha] = strokes[kind];
      const stroke = colour.map((c) => Math.round(c * (1 - alpha) + grey * alpha));
      assert.ok(contrast(colour, stroke) >= 1.1, `${colour}: ${kind} strokes are not seen`);
      const ink = kind === "dark" ? [255, 255, 255] : [0, 0, 0];
      assert.ok(contrast(stroke, ink) >= 4.5, `${colour}: the number on ${kind} strokes`);
    }
  }
});
