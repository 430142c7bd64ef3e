// The one EventSource: stale, reconnecting, gaps. A world of the test's own instead of a browser's.
import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";
import { STALE_MS, Stream } from "../page/js/stream.js";

class Source extends EventTarget {
  static all = [];
  constructor() {
    super();
    this.closed = false;
    Source.all.push(this);
  }
  close() {
    this.closed = true;
  }
  send(name, data) {
    this.dispatchEvent(Object.assign(new Event(name), { data: JSON.stringify(data) }));
  }
}
const last = () => Source.all.at(-1);
let frames = [];
let now = 0;
const pass = (ms) => {
  for (let k = 0; k < ms; k += 50) {
    now += 50;
    mock.timers.tick(50);
  }
};
const frame = () => frames.splice(0).forEach((draw) => draw());
let stream;

beforeEach(() => {
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  globalThis.document = Object.assign(new EventTarget(), { hidden: false });
  globalThis.requestAnimationFrame = (draw) => frames.push(draw);
  Source.all = [];
  frames = [];
  now = 0;
  stream = new Stream("live", { open: () => new Source(), now: () => now });
  stream.start();
});
afterEach(() => {
  stream.stop();
  mock.timers.reset();
});

test("stale after three seconds of silence, fresh with the next event, and the gap is named", () => {
  const states = [];
  const gaps = [];
  stream.on("state", (state) => states.push(state.stale));
  stream.on("gap", (gap) => gaps.push(gap));
  last().send("telemetry", { at_ms: 1000, devices: {} });
  pass(STALE_MS - 100);
  assert.deepEqual(states, []);
  pass(400);
  assert.deepEqual(states, [true]);
  last().send("telemetry", { at_ms: 5000, devices: {} });
  assert.deepEqual(states, [true, false]);
  assert.deepEqual(gaps, [{ from_ms: 1000, to_ms: 5000 }]);
});

test("a connection that failed is made anew, ever more slowly, and one at a time", () => {
  for (let k = 0; k < 6; k += 1) {
    last().dispatchEvent(new Event("error"));
    pass(12_000);
  }
  assert.ok(Source.all.length >= 7 && Source.all.length < 20, `${Source.all.length} connections in 72 s`);
  assert.equal(Source.all.filter((source) => !source.closed).length, 1);
});

test("a dead link without an error is given up", () => {
  last().send("telemetry", { at_ms: 1, devices: {} });
  pass(10_000);
  assert.ok(Source.all.length >= 2 && Source.all[0].closed);
});

test("drawing hears once a frame, with what came meanwhile merged", () => {
  const drawn = [];
  const heard = [];
  stream.frame("telemetry", (event) => drawn.push(event.at_ms));
  stream.frame("notice", (list) => drawn.push(list.length));
  stream.on("telemetry", (event) => heard.push(event.at_ms));
  for (let k = 1; k <= 5; k += 1) last().send("telemetry", { at_ms: k, devices: {} });
  for (let k = 0; k < 3; k += 1) last().send("notice", { event: "state" });
  assert.deepEqual(drawn, []);
  frame();
  assert.deepEqual(drawn, [5, 3]);
  assert.deepEqual(heard, [1, 2, 3, 4, 5]);
});

test("hidden draws nothing, and nothing piles up", () => {
  const drawn = [];
  stream.frame("notice", (list) => drawn.push(list.length));
  stream.frame("missed", ({ missed }) => drawn.push(`missed ${missed}`));
  globalThis.document.hidden = true;
  for (let k = 0; k < 5000; k += 1) last().send("notice", { event: "state" });
  frame();
  assert.deepEqual(drawn, []);
  globalThis.document.hidden = false;
  globalThis.document.dispatchEvent(new Event("visibilitychange"));
  frame();
  assert.deepEqual(drawn, [1000, "missed 4000"]);
});

test("nonsense on the line harms nobody", () => {
  const heard = [];
  stream.on("telemetry", (event) => heard.push(event));
  last().dispatchEvent(Object.assign(new Event("telemetry"), { data: "{not json" }));
  assert.deepEqual(heard, []);
});

test("a listener that throws does not stop the others", () => {
  const heard = [];
  const silenced = mock.method(console, "error", () => {});
  stream.on("devices", () => {
    throw new Error("mine");
  });
  stream.on("devices", (reports) => heard.push(reports.length));
  last().send("devices", [1, 2]);
  assert.deepEqual(heard, [2]);
  assert.equal(silenced.mock.callCount(), 1);
});

test("at rest it holds no connection and tries none; awake it says that there was a gap", () => {
  const gaps = [];
  stream.on("gap", (gap) => gaps.push(gap));
  last().send("telemetry", { at_ms: 1000, devices: {} });
  stream.rest();
  pass(60_000);
  assert.equal(Source.all.filter((source) => !source.closed).length, 0);
  assert.equal(Source.all.length, 1);
  stream.wake();
  last().send("telemetry", { at_ms: 61_000, devices: {} });
  assert.deepEqual(gaps, [{ from_ms: 1000, to_ms: 61_000 }]);
  assert.equal(stream.state.stale, false);
});

test("any event is a sign of life; the gap is named when the daemon's clock is known again", () => {
  const gaps = [];
  stream.on("gap", (gap) => gaps.push(gap));
  last().send("telemetry", { at_ms: 1000, devices: {} });
  last().dispatchEvent(new Event("error"));
  pass(5000);
  assert.equal(stream.state.stale, true);
  last().send("devices", []);
  assert.deepEqual([stream.state.stale, stream.state.failures, gaps.length], [false, 0, 0]);
  last().send("telemetry", { at_ms: 7000, devices: {} });
  last().send("telemetry", { at_ms: 7200, devices: {} });
  assert.deepEqual(gaps, [{ from_ms: 1000, to_ms: 7000 }]);
});
