// Two intervals of the live stream as one: nothing that was extreme is lost.
import assert from "node:assert/strict";
import { test } from "node:test";
import { heats, mergeTelemetry } from "../page/js/telemetry.js";

const live = (power_w, f_sw_hz = 40_000) => ({ half_cycle: 1, state: "Heating", pot: "Ferromagnetic", fault: 0, fault_text: "", limit: "None", asked_w: 1000, power_w, f_sw_hz, i_crest_a: 30, r_ohm: 4, l_h: 30e-6 });
const one = (power, r, last, half_cycles = 10, skipped = 0) => ({ half_cycles, skipped, last: live(last), phase_deg: 40, resonance_hz: 28e3, power_w: power, r_ohm: r, l_h: null, f_sw_hz: [39e3, 41e3] });

test("extremes of both, the later last, counts added", () => {
  const merged = mergeTelemetry({ at_ms: 100, devices: { a: one([900, 1100], [3.9, 4.1], 950, 20, 1) } }, { at_ms: 300, devices: { a: one([950, 1300], [4.0, 4.6], 1010, 21, 2) } });
  assert.equal(merged.at_ms, 300);
  const { a } = merged.devices;
  assert.deepEqual([a.power_w, a.r_ohm, a.l_h, a.half_cycles, a.skipped, a.last.power_w], [[900, 1300], [3.9, 4.6], null, 41, 3, 1010]);
});

test("who was silent in one of them is not lost", () => {
  const merged = mergeTelemetry({ at_ms: 1, devices: { a: one([1, 2], null, 1) } }, { at_ms: 2, devices: { b: one([3, 4], null, 3) } });
  assert.deepEqual(Object.keys(merged.devices).sort(), ["a", "b"]);
  assert.equal(mergeTelemetry({ at_ms: 1, devices: { a: one([1, 2], null, 1) } }, { at_ms: 2, devices: { a: one([3, 4], [1, 2], 3) } }).devices.a.r_ohm[0], 1);
});

test("merging is associative in what is drawn", () => {
  const events = [[5, 9], [1, 3], [7, 20]].map(([a, b], k) => ({ at_ms: k, devices: { a: one([a, b], [a / 10, b / 10], b, 5) } }));
  const left = mergeTelemetry(mergeTelemetry(events[0], events[1]), events[2]);
  const right = mergeTelemetry(events[0], mergeTelemetry(events[1], events[2]));
  assert.deepEqual(left, right);
});

test("only a switched inverter has R and L", () => {
  assert.equal(heats(live(0, 0)), false);
  assert.equal(heats(live(1000, 34_000)), true);
  assert.equal(heats(null), false);
});
