// R and L of now: the network's where its window is young and of the frequency of now, else the device's own.
import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { Fleet, RESULT_LASTS_MS } from "../page/js/fleet.js";

const T0 = 1_700_000_000_000;
let clock_ms, fleet, tell;

/** A live stream that says what the test says, and a device that heats at 50 kHz. */
beforeEach(() => {
  clock_ms = T0;
  const heard = {};
  const stream = { on: (name, listener) => (heard[name] = listener), daemonNow_ms: () => clock_ms, lastAt_ms: T0 };
  fleet = new Fleet(stream);
  tell = (name, event) => heard[name](event);
  fleet.setReports([{ name: "bench", state: "learning" }]);
  heat(50_000);
});

const heat = (f_sw_hz) => tell("telemetry", { at_ms: clock_ms, devices: { bench: { half_cycles: 1, last: { f_sw_hz, r_ohm: 9, l_h: 9e-6 } } } });
const window = (seq, at_ms = clock_ms, boot = 1) => tell("notice", { event: "window-stored", device: "bench", boot, seq, at_ms });
const result = (seq, f_sw_hz, r_ohm, boot = 1) => tell("notice", { event: "result-stored", device: "bench", boot, seq, f_sw_hz, r_ohm, l_h: 20e-6, pass: true, why: "", at_ms: clock_ms });
const now = () => fleet.now("bench");

test("a young window of the frequency of now is told, and which it is", () => {
  window(3);
  clock_ms += 500;
  result(3, 50_000, 3.7);
  assert.deepEqual(now(), { r_ohm: 3.7, l_h: 20e-6, source: "network", at_ms: T0, window: { boot: 1, seq: 3 } });
});

test("while control moves, what was seen at another frequency is none of now", () => {
  window(0);
  // R grows about as the frequency does: at 70 kHz it is a third more than at 55.
  result(0, 69_900, 4.6);
  assert.deepEqual([now().source, now().r_ohm, now().window], ["device", 9, null]);
  heat(69_600);
  assert.deepEqual([now().source, now().r_ohm], ["network", 4.6]);
});

test("a result is as old as its window, however late it comes", () => {
  window(1);
  clock_ms += RESULT_LASTS_MS - 1;
  result(1, 50_000, 3.7);
  assert.equal(now().source, "network");
  assert.equal(now().at_ms, T0);
  clock_ms += 1;
  assert.equal(now().source, "device");
});

test("a result of a window that was never heard of is none of now", () => {
  result(1, 50_000, 3.7);
  assert.equal(now().source, "device");
});

test("results that come out of order leave the newest window's", () => {
  for (const seq of [5, 6]) window(seq, T0 + seq);
  result(6, 50_000, 3.6);
  result(5, 50_000, 3.5);
  assert.equal(now().r_ohm, 3.6);
  // A boot counts anew.
  window(0, T0 + 100, 2);
  result(0, 50_000, 3.4, 2);
  assert.equal(now().r_ohm, 3.4);
});

test("a clock that is set back leaves nothing of before it, nor does the store", () => {
  window(1);
  result(1, 50_000, 3.7);
  clock_ms -= 3_600_000;
  heat(50_000);
  assert.equal(now().source, "device");
  // As the store has it after a reload.
  window(1, T0);
  result(1, 50_000, 3.7);
  assert.equal(now().source, "device");
  window(2);
  result(2, 50_000, 3.6);
  assert.deepEqual([now().source, now().r_ohm], ["network", 3.6]);
});

test("one that the gate refused is not told, and the times of windows are few", () => {
  window(1);
  tell("notice", { event: "result-stored", device: "bench", boot: 1, seq: 1, f_sw_hz: 50_000, r_ohm: 1, l_h: 1e-6, pass: false, at_ms: clock_ms });
  assert.equal(now().source, "device");
  for (let seq = 2; seq < 5000; seq++) window(seq);
  assert.ok(fleet.windows.get("bench").size <= 128);
});
