import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { cividis, contrast, diverging, fromHex, inkOn, lightness, viridis } from "../page/js/colour.js";

const steps = Array.from({ length: 101 }, (_, k) => k / 100);

for (const [name, map] of Object.entries({ cividis, viridis })) {
  test(`${name} grows lighter all the way, and by enough to be a scale in grey`, () => {
    const l = steps.map((t) => lightness(map(t)));
    for (let k = 1; k < l.length; k++) assert.ok(l[k] > l[k - 1] - 0.35, `at ${steps[k]}: ${l[k - 1]} to ${l[k]}`);
    for (let k = 5; k < l.length; k++) assert.ok(l[k] > l[k - 5], `at ${steps[k]}`);
    assert.ok(l.at(-1) - l[0] > 70);
  });
}

test("the maps' ends are matplotlib's", () => {
  assert.deepEqual(cividis(0), [0, 34, 78]);
  assert.deepEqual(cividis(1), [254, 232, 56]);
  assert.deepEqual(viridis(0), [68, 1, 84]);
  assert.deepEqual(viridis(1), [253, 231, 37]);
});

test("beyond the ends a map stays at its ends, and no number breaks it", () => {
  assert.deepEqual(viridis(-3), viridis(0));
  assert.deepEqual(viridis(9), viridis(1));
  assert.deepEqual(viridis(NaN), viridis(0));
  assert.deepEqual(diverging(-7), diverging(-1));
  assert.deepEqual(diverging(NaN), diverging(0));
});

for (const dark of [false, true]) {
  test(`differences, ${dark ? "dark" : "light"}: neutral in the middle, both arms alike in lightness and one way`, () => {
    const [r, g, b] = diverging(0, dark);
    assert.ok(Math.max(r, g, b) - Math.min(r, g, b) <= 4, "zero is grey");
    const sign = dark ? 1 : -1;
    let before = lightness(diverging(0, dark));
    for (const t of steps.slice(1)) {
      const [above, below] = [lightness(diverging(t, dark)), lightness(diverging(-t, dark))];
      assert.ok(Math.abs(above - below) < 1.5, `arms differ at ${t}: ${above}, ${below}`);
      assert.ok(sign * (above - before) > -0.6, `turns back at ${t}`);
      before = above;
    }
    assert.ok(Math.abs(lightness(diverging(1, dark)) - lightness(diverging(0, dark))) > 45);
    const [, , blueBelow] = diverging(-1, dark);
    const [redAbove, , blueAbove] = diverging(1, dark);
    assert.ok(blueBelow > blueAbove && redAbove > blueAbove, "blue below zero, orange above");
  });
}

/** What who lacks the middle cones sees (Machado et al. 2009, severity 1), in linear light. */
function deuteranope(colour) {
  const linear = colour.map((c) => (c <= 10 ? c / 3294.6 : ((c / 255 + 0.055) / 1.055) ** 2.4));
  const rows = [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]];
  const out = rows.map((row) => row.reduce((sum, w, k) => sum + w * linear[k], 0));
  return out.map((u) => Math.round(255 * (u <= 0.0031308 ? 12.92 * Math.max(u, 0) : 1.055 * Math.min(u, 1) ** (1 / 2.4) - 0.055)));
}

test("the two arms of a difference can be told apart without green cones", () => {
  for (const dark of [false, true]) {
    const [a, b] = [deuteranope(diverging(0.6, dark)), deuteranope(diverging(-0.6, dark))];
    assert.ok(Math.abs(a[2] - b[2]) > 60, `${a} and ${b}`);
  }
});

test("ink can be read on every colour of every map", () => {
  for (const t of steps) {
    for (const colour of [cividis(t), viridis(t), ...[false, true].flatMap((d) => [diverging(t, d), diverging(-t, d)])]) {
      assert.ok(contrast(colour, fromHex(inkOn(colour))) >= 4.5, `${colour}`);
    }
  }
});

/** Colours of page.css, by theme. */
function variables(dark) {
  const sheet = readFileSync(new URL("../page/page.css", import.meta.url), "utf8");
  const blocks = [/:root \{([^}]*)\}/, /:root\[data-theme="dark"\] \{([^}]*)\}/].map((block) => sheet.match(block)[1]);
  const own = (block) => Object.fromEntries([...block.matchAll(/--([\w-]+): (#[0-9a-f]{6});/g)].map(([, name, hex]) => [name, fromHex(hex)]));
  return dark ? { ...own(blocks[0]), ...own(blocks[1]) } : own(blocks[0]);
}

for (const dark of [false, true]) {
  test(`the page's colours stand out, ${dark ? "dark" : "light"}: series by 3 to 1, text by 4.5 to 1`, () => {
    const colours = variables(dark);
    for (const back of ["paper", "panel"]) {
      for (const name of ["s1", "s2", "s3", "s4", "s5", "s6", "s7"]) {
        assert.ok(contrast(colours[name], colours[back]) >= 3, `${name} on ${back}`);
      }
      for (const name of ["ink", "ink2", "link", "good", "bad", "warn"]) {
        assert.ok(contrast(colours[name], colours[back]) >= 4.5, `${name} on ${back}: ${contrast(colours[name], colours[back])}`);
      }
    }
  });
}
