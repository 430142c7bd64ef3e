import assert from "node:assert/strict";
import { test } from "node:test";
import { fileOf, nameOf, settings, triggerWords, words } from "../page/js/recording/settings.js";

const form = (more = {}) => ({ on: "now", quantity: "power", level: "1000", direction: "rising", preTrigger: "5", duration: "30", ...more });

test("what is filled in is what the daemon takes", () => {
  assert.deepEqual(settings(form()).settings, { trigger: { on: "now" }, pre_trigger_s: 5, duration_s: 30 });
  assert.deepEqual(settings(form({ on: "fault", preTrigger: "", duration: " " })).settings, { trigger: { on: "fault" }, pre_trigger_s: 0, duration_s: null });
  const level = settings(form({ on: "level", quantity: "inductance", level: "28,5", direction: "falling" })).settings;
  assert.deepEqual(level.trigger, { on: "level", quantity: "inductance", level: 28.5, rising: false });
});

test("what cannot be is refused with its field", () => {
  for (const [more, field] of [
    [{ preTrigger: "61" }, "preTrigger"],
    [{ preTrigger: "-1" }, "preTrigger"],
    [{ preTrigger: "five" }, "preTrigger"],
    [{ duration: "0" }, "duration"],
    [{ duration: "1e9" }, "duration"],
    [{ on: "level", level: "" }, "level"],
    [{ on: "level", quantity: "resistance", level: "1000" }, "level"],
    [{ on: "level", level: "NaN" }, "level"],
  ]) {
    assert.equal(settings(form(more)).field, field, JSON.stringify(more));
  }
  assert.ok("settings" in settings(form({ level: "nonsense" })), "a level that is not asked for is not looked at");
});

test("settings are said in words with their units", () => {
  const given = settings(form({ on: "level", quantity: "frequency", level: "45", duration: "" })).settings;
  assert.equal(words(given), "Begins when Switching frequency rises above 45 kHz, with the 5 s before it, and goes on until it is stopped.");
  assert.equal(triggerWords({ on: "fault" }), "when a fault trips");
  assert.equal(triggerWords(null), "at once");
});

test("a download has the name that the daemon gives, and no folder", () => {
  assert.equal(nameOf('attachment; filename="bench-2026.half-cycles.csv"'), "bench-2026.half-cycles.csv");
  assert.equal(nameOf("attachment; filename=a.npz"), "a.npz");
  assert.equal(nameOf('attachment; filename="../../etc/passwd"'), "passwd");
  for (const none of [null, "", "attachment", 'attachment; filename=""']) assert.equal(nameOf(none), null);
  assert.equal(fileOf("/var/lib/ihd/recordings/bench.mcap"), "bench.mcap");
  assert.equal(fileOf("C:\\ihd\\bench.mcap"), "bench.mcap");
  assert.equal(fileOf(null), "");
});
