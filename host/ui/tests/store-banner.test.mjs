import assert from "node:assert/strict";
import { test } from "node:test";
import { StoreBanner, bannerLines } from "../page/js/store-banner.js";

const failing = (dropped) => ({
  store: false,
  store_failure: { cause: "disk-full", text: "the store's disk is full", advice: "Free space.", since_ms: 1_795_348_800_000, dropped },
});

test("no banner while the store takes everything, nor from a daemon that knows no failures", () => {
  for (const health of [{ store: true, store_failure: null }, { store: true }, null, undefined]) {
    assert.deepEqual(bannerLines(health), []);
  }
});

test("the banner says why, since when, what is lost and what to do", () => {
  const [why, lost, advice] = bannerLines(failing({ windows: 12, results: 0, telemetry_s: 0, events: 1, audits: 0 }));
  assert.match(why, /disk is full, since \d/);
  assert.equal(lost, "Lost since then: 12 windows, 1 event.");
  assert.equal(advice, "Free space.");
  assert.equal(bannerLines(failing({ windows: 0 }))[1], "Nothing is lost so far.");
});

test("the store is asked about again once the stream is open, and only then", () => {
  const listeners = new Map();
  const stream = { on: (name, listener) => (listeners.set(name, listener), () => listeners.delete(name)) };
  let asked = 0;
  new StoreBanner({ hidden: true, dataset: {}, replaceChildren() {} }, stream, () => (asked++, Promise.resolve({ store: true })));
  assert.equal(asked, 1);
  listeners.get("devices")();
  assert.equal(asked, 2);
  assert.equal(listeners.has("devices"), false);
});
