// Power as a lease, state by state (docs/daemon.md: 10 s, renewed every 3 s).
import assert from "node:assert/strict";
import { test } from "node:test";
import { LATE_MS, noLease, pageAlive, step } from "../page/js/lease-machine.js";

const run = (...events) => events.reduce(step, noLease());
const held = () => run({ type: "take", power_w: 1200, at_ms: 0 }, { type: "powered", power_w: 1200, at_ms: 100 });

test("heating begins when the power was acknowledged, not when it was asked for", () => {
  assert.equal(run({ type: "take", power_w: 1200, at_ms: 0 }).phase, "taking");
  assert.deepEqual([held().phase, held().power_w], ["held", 1200]);
  const reduced = run({ type: "take", power_w: 3000, at_ms: 0 }, { type: "powered", power_w: 2500, asked_w: 3000, at_ms: 100 });
  assert.deepEqual([reduced.power_w, reduced.asked_w], [2500, 3000]);
});

test("a refusal leaves nothing behind but its reason", () => {
  const state = run({ type: "take", power_w: 1200, at_ms: 0 }, { type: "refused", why: "no pot" });
  assert.deepEqual([state.phase, state.power_w, state.why], ["none", 0, "no pot"]);
});

test("power that is acknowledged after Off does not come back", () => {
  const state = run({ type: "take", power_w: 1200, at_ms: 0 }, { type: "off" }, { type: "powered", power_w: 1200, at_ms: 50 });
  assert.equal(state.phase, "none");
});

test("renewals that do not come through are said, then the lease is over", () => {
  const tick = (at_ms) => ({ type: "tick", at_ms: 100 + at_ms, lease_ms: 10_000 });
  assert.equal(step(held(), tick(3000)).phase, "held");
  assert.equal(step(held(), tick(LATE_MS + 1)).phase, "late");
  const late = step(held(), tick(LATE_MS + 1));
  assert.equal(step(late, { type: "renewed", at_ms: 6000 }).phase, "held");
  assert.equal(step(late, tick(10_000)).phase, "late");
  assert.equal(step(late, tick(10_001)).phase, "lost");
});

test("a renewal that was overtaken does not make the lease older", () => {
  const state = step(step(held(), { type: "renewed", at_ms: 6000 }), { type: "renewed", at_ms: 3000 });
  assert.equal(state.renewed_ms, 6000);
});

test("taken over: who did it is told, until it was read", () => {
  const state = step(held(), { type: "taken", by: "ada" });
  assert.equal(state.phase, "lost");
  assert.match(state.why, /ada/);
  assert.equal(step(state, { type: "renewed", at_ms: 1 }).phase, "lost", "a late renewal revives nothing");
  assert.equal(step(state, { type: "seen" }).phase, "none");
});

test("Off ends it from every state", () => {
  const states = [noLease(), run({ type: "take", power_w: 1, at_ms: 0 }), held(), step(held(), { type: "taken", by: "x" })];
  for (const state of states) assert.equal(step(state, { type: "off" }).phase, "none");
});

test("another power under the same lease keeps it", () => {
  const state = step(step(held(), { type: "take", power_w: 800, at_ms: 500 }), { type: "refused", why: "the device said no" });
  assert.deepEqual([state.phase, state.power_w], ["held", 1200]);
});

test("a page that does not answer is not alive", () => {
  assert.equal(pageAlive(1000, 5000, 4000), true);
  assert.equal(pageAlive(1000, 5001, 4000), false);
});
