import assert from "node:assert/strict";
import { test } from "node:test";
import { fromNotice, isAlarm, matches, older, withNewest, withOlder } from "../page/js/journal.js";

const entry = (at_ms, text = "x", more = {}) => ({ at_ms, device: "bench", kind: "pot", holder: "", text, ...more });

/** The daemon's journal: `before` is exclusive here; the other meaning is tried too. */
const journal = (all, before, limit, inclusive) =>
  all.filter((e) => (inclusive ? e.at_ms <= before : e.at_ms < before)).sort((a, b) => b.at_ms - a.at_ms).slice(0, limit);

for (const inclusive of [false, true]) {
  test(`every entry comes once however many share a millisecond, before ${inclusive ? "inclusive" : "exclusive"}`, () => {
    // A seeded journal with bursts: up to 25 entries in a millisecond, pages of 10.
    let seed = 1;
    const random = () => (seed = (seed * 48_271) % 2_147_483_647) / 2_147_483_647;
    const all = [];
    for (let at = 1000; all.length < 400; at += Math.ceil(random() * 3)) {
      const burst = random() < 0.1 ? 25 : 1;
      for (let k = 0; k < burst; k++) all.push(entry(at, `${random() < 0.5 ? "same" : all.length}`));
    }
    let list = withNewest([], journal(all, Infinity, 10, inclusive));
    for (let rounds = 0, stuck = 0; rounds < 500; rounds++) {
      const ask = older(list, 10, stuck);
      const page = journal(all, ask.before, ask.limit, inclusive);
      const before = list.length;
      list = withOlder(list, page);
      stuck = list.length > before ? 0 : stuck + 1;
      if (page.length < ask.limit) break;
    }
    const key = (e) => `${e.at_ms} ${e.text}`;
    assert.deepEqual(list.map(key).sort(), all.map(key).sort());
    for (let k = 1; k < list.length; k++) assert.ok(list[k - 1].at_ms >= list[k].at_ms);
  });
}

test("a live notice gives way to its entry of the journal, one for one", () => {
  const live = (at, text, kind = "fault") => ({ ...entry(at, text, { kind }), live: true });
  const told = [live(5003, "4: over current"), live(5001, "idle", "state"), live(4000, "4: over current")];
  const page = [entry(5000, "4: over current", { kind: "fault" })];
  const list = withNewest(told, page);
  assert.deepEqual(list.map((e) => [e.at_ms, e.kind, e.live === true]), [[5001, "state", true], [5000, "fault", false], [4000, "fault", true]]);
  // Read again: nothing changes, and the remaining live one does not give way to an entry that stands for another.
  assert.equal(withNewest(list, page).length, 3);
  assert.equal(withNewest(list, [...page, entry(3990, "4: over current", { kind: "fault" })]).filter((e) => e.live).length, 1);
});

test("a live notice of a device that never connected gives way to the entry that has its name in the text", () => {
  const told = [{ ...entry(5000, "no answer", { device: "ghost", kind: "state" }), live: true }];
  assert.equal(withNewest(told, [entry(5001, "ghost: searching: no answer", { device: "", kind: "state" })]).length, 1);
});

test("of another device or kind, or long before, an entry stands for no notice", () => {
  const told = [{ ...entry(5000), live: true }];
  for (const other of [entry(5000, "x", { device: "desk" }), entry(5000, "x", { kind: "off" }), entry(1000)]) {
    assert.equal(withNewest(told, [other]).length, 2);
  }
});

test("what comes several times a second is not told; everything else is, in words", () => {
  for (const event of ["telemetry", "window-stored", "result-stored"]) assert.equal(fromNotice({ at_ms: 1, device: "bench", event }), null);
  const say = (more) => fromNotice({ at_ms: 1, device: "bench", ...more });
  assert.equal(say({ event: "fault", fault: 4, text: "over current" }).text, "4: over current");
  assert.equal(isAlarm(say({ event: "fault", fault: 4, text: "over current" })), true);
  assert.equal(isAlarm(say({ event: "fault", fault: 0, text: "no fault" })), false);
  assert.equal(say({ event: "lease", holder: "", taken_from: "", why: "it has run out" }).text, "nobody commands it: it has run out");
  assert.equal(say({ event: "lease", holder: "ada", taken_from: "bob" }).text, "ada commands it, taken from bob");
  assert.match(say({ event: "command", holder: "ada", text: "power 1200 W", ok: false }).text, /not carried out/);
  assert.equal(say({ event: "recording", phase: "begun", text: "begun by a fault", file: "a.mcap" }).kind, "recording");
  assert.equal(say({ event: "recording", phase: "ended", text: "30 s are over", file: "a.mcap" }).text, "a.mcap: 30 s are over");
  assert.equal(isAlarm(say({ event: "lookup-refused", version: 4, why: "slope" })), true);
  assert.equal(isAlarm(say({ event: "lookup-active", version: 4, observed_cells: 9 })), false);
  assert.equal(isAlarm(say({ event: "state", state: "faulted", detail: "over current" })), true);
  assert.match(say({ event: "something-new", number: 7 }).text, /7/);
  assert.equal(fromNotice(null), null);
});

test("a filter is of device, kind, words in any case and time; the end is not in it", () => {
  const all = { device: null, kind: "", text: "", since_ms: null, before_ms: null };
  const one = entry(5000, "The Pot was taken away");
  for (const [filter, through] of [
    [{}, true],
    [{ device: "" }, false],
    [{ device: "bench" }, true],
    [{ kind: "fault" }, false],
    [{ text: " pot WAS " }, true],
    [{ text: "lid" }, false],
    [{ since_ms: 5000 }, true],
    [{ since_ms: 5001 }, false],
    [{ before_ms: 5000 }, false],
    [{ before_ms: 5001 }, true],
  ]) {
    assert.equal(matches(one, { ...all, ...filter }), through, JSON.stringify(filter));
  }
  assert.equal(matches(entry(1, "x", { device: "" }), { ...all, device: "" }), true, "the daemon itself");
});
