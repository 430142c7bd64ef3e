// Rows of the fleet's page: ages in words, filter, order, and which of a thousand have to be there.
import assert from "node:assert/strict";
import { test } from "node:test";
import { DEVICES } from "../page/js/fleet-report/columns.js";
import { ageText, devicesText, filtered, inView, isSilent, protocolText, seenText, serverText, sorted } from "../page/js/fleet-report/rows.js";

const NOW = 1_795_000_000_000;
const device = (name, more = {}) => ({ name, edge: "cellar", state: "idle", pot: "", build: "ihd 0.1.0", protocol: [2, 6], lookup_version: 3, outdated: false, last_seen_ms: NOW, ...more });
const names = (rows) => rows.map((row) => row.name);
const column = (key) => DEVICES.find((one) => one.key === key);
const nothing = { text: "", outdated: false, silent: false };

test("silent is who was not heard of for more than 30 s", () => {
  assert.equal(isSilent({ last_seen_ms: NOW - 30_000 }, NOW), false);
  assert.equal(isSilent({ last_seen_ms: NOW - 30_001 }, NOW), true);
  assert.equal(isSilent({ last_seen_ms: 0 }, NOW), true);
});

test("last seen in words, and silence has its own", () => {
  const text = (age_s) => seenText(NOW - 1000 * age_s, NOW).replaceAll("\u00a0", " ");
  assert.equal(text(0), "now");
  assert.equal(text(1.9), "now");
  assert.equal(text(2), "2 s ago");
  assert.equal(text(29.9), "29 s ago");
  assert.equal(text(31), "silent for 31 s");
  assert.equal(text(7 * 3600), "silent for 7 h 0 min");
  assert.equal(seenText(0, NOW), "never");
  // Clocks that differ a little are right; one of tomorrow is not taken for now.
  assert.equal(text(-4), "now");
  assert.match(text(-7200), /in 2 h.*clock is wrong/);
});

test("the filter takes every word, wherever it stands, and words as they are shown", () => {
  const rows = [
    device("hob-1", { edge: "cellar", state: "waiting-for-pot", pot: "Absent" }),
    device("hob-2", { edge: "attic", state: "learning", pot: "Ferromagnetic", build: "ihd 0.2.0", protocol: [3, 0] }),
    device("probe", { edge: "attic", outdated: true, last_seen_ms: NOW - 60_000 }),
  ];
  const by = (filter) => names(filtered(rows, { ...nothing, ...filter }, NOW));
  assert.deepEqual(by({}), ["hob-1", "hob-2", "probe"]);
  assert.deepEqual(by({ text: "  ATTIC   hob " }), ["hob-2"]);
  assert.deepEqual(by({ text: "waiting for" }), ["hob-1"]);
  assert.deepEqual(by({ text: "waiting-for-pot" }), ["hob-1"]);
  assert.deepEqual(by({ text: "can be heated" }), ["hob-2"]);
  assert.deepEqual(by({ text: "3.0" }), ["hob-2"]);
  assert.deepEqual(by({ text: "hob attic cellar" }), []);
  assert.deepEqual(by({ outdated: true }), ["probe"]);
  assert.deepEqual(by({ silent: true }), ["probe"]);
  assert.deepEqual(by({ silent: true, text: "hob" }), []);
  // No pattern of anything: a text.
  assert.deepEqual(by({ text: ".*" }), []);
});

test("sorted by numbers as numbers, by names as people count, equals by name", () => {
  const rows = [device("hob-10", { lookup_version: 9 }), device("hob-9", { lookup_version: 10 }), device("hob-2", { lookup_version: 9 })];
  const by = (key, down) => names(sorted(rows, column(key).by, down));
  assert.deepEqual(by("name", false), ["hob-2", "hob-9", "hob-10"]);
  assert.deepEqual(by("name", true), ["hob-10", "hob-9", "hob-2"]);
  assert.deepEqual(by("lookup", false), ["hob-2", "hob-10", "hob-9"]);
  assert.deepEqual(by("lookup", true), ["hob-9", "hob-2", "hob-10"]);
  assert.deepEqual(names(rows), ["hob-10", "hob-9", "hob-2"], "what was given stays as it is");
});

test("protocol 2.10 comes after 2.9", () => {
  const rows = [device("a", { protocol: [2, 10] }), device("b", { protocol: [2, 9] }), device("c", { protocol: [0, 0] })];
  assert.deepEqual(names(sorted(rows, column("protocol").by, false)), ["c", "b", "a"]);
  assert.equal(protocolText([2, 10]), "2.10");
  assert.equal(protocolText([0, 0]), "");
});

test("of any number of rows those in view are there, and never one that is not", () => {
  const row = 26;
  for (const n of [0, 1, 5, 40, 1000, 100_000]) {
    for (const height of [0, 10, 600]) {
      for (const top of [0, 1, 25.5, 333, n * row - height, n * row + 5000, -7]) {
        const [first, end] = inView(top, height, row, n);
        assert.ok(0 <= first && first <= end && end <= n, `${n} ${height} ${top}: ${first} ${end}`);
        assert.ok(end - first <= height / row + 20, `${end - first} rows`);
        // Whatever is at a pixel that is seen is there.
        for (const y of [top, top + height / 2, top + height - 1]) {
          const at = Math.floor(y / row);
          if (height > 0 && y >= top && at >= 0 && at < n) assert.ok(first <= at && at < end, `${n} ${height} ${top}: row ${at} of ${first} to ${end}`);
        }
      }
    }
  }
});

test("the head says whether the server answers, why not, and how old the numbers are", () => {
  const report = { server: "nats://a:4222", connected: true, why: "", at_ms: NOW - 500 };
  assert.equal(serverText(report), "● connected to nats://a:4222");
  assert.equal(ageText(report, NOW), "the numbers are of now");
  const gone = { ...report, connected: false, why: "no answer", at_ms: NOW - 600_000 };
  assert.equal(serverText(gone), "✖ not connected to nats://a:4222: no answer");
  assert.equal(ageText(gone, NOW).replaceAll("\u00a0", " "), "the numbers are 10 min old");
  assert.equal(ageText({ ...gone, at_ms: 0 }, NOW), "nothing is known of the fleet yet");
});

test("how many there are, how many of them are shown", () => {
  const rows = [device("a", { outdated: true }), device("b", { last_seen_ms: NOW - 40_000 }), device("c")];
  assert.equal(devicesText(rows, 3, NOW), "3 devices: 1 outdated, 1 silent");
  assert.equal(devicesText(rows, 1, NOW), "1 of 3 devices: 1 outdated, 1 silent");
  assert.equal(devicesText([], 0, NOW), "No edge has told of a device yet.");
});

test("words that a machine made up are shown as they are, not looked up in the language", () => {
  const odd = device("__proto__", { state: "constructor", pot: "toString" });
  const text = (key) => column(key).text(odd, NOW);
  assert.equal(text("name"), "__proto__");
  assert.equal(text("state"), "· constructor");
  assert.equal(text("pot"), "to string");
  assert.equal(column("state").look(odd, NOW), "");
});
