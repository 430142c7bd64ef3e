// Newest wins: never two requests under way.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Newest } from "../page/js/newest.js";

const settle = () => new Promise((wake) => setTimeout(wake, 1));

test("what was asked for meanwhile is done once, with the newest wish", async () => {
  const done = [];
  let under = 0;
  const gates = [];
  const newest = new Newest(async (wish) => {
    under += 1;
    assert.equal(under, 1, "one at a time");
    await new Promise((open) => gates.push(open));
    under -= 1;
    done.push(wish);
  }, assert.fail);
  for (let k = 1; k <= 50; k += 1) newest.ask(k);
  gates.shift()();
  await settle();
  gates.shift()();
  await settle();
  assert.deepEqual(done, [1, 50]);
  assert.equal(gates.length, 0);
});

test("a failure is told, and ends nothing", async () => {
  const told = [];
  const done = [];
  const newest = new Newest(async (wish) => {
    if (wish === 1) throw new Error("no");
    done.push(wish);
  }, (why) => told.push(why.message));
  newest.ask(1);
  await settle();
  newest.ask(2);
  await settle();
  assert.deepEqual([told, done], [["no"], [2]]);
});

test("stopped, it does nothing more and complains of nothing", async () => {
  const done = [];
  const newest = new Newest(async (wish, signal) => {
    await settle();
    if (signal.aborted) throw new Error("aborted");
    done.push(wish);
  }, assert.fail);
  newest.ask(1);
  newest.ask(2);
  newest.stop();
  await settle();
  await settle();
  assert.deepEqual(done, []);
});
