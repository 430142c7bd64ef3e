// Leases of a page whose worker renews nothing, by a clock that a test moves.
import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

let now_ms, requests, leases;

beforeEach(async () => {
  mock.reset();
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  [now_ms, requests] = [0, []];
  mock.method(performance, "now", () => now_ms);
  mock.method(globalThis, "fetch", async (url, { method }) => {
    requests.push(`${method} ${new URL(url).pathname.split("/").at(-1)}`);
    return new Response(method === "DELETE" ? null : "{}", { status: method === "DELETE" ? 204 : 200 });
  });
  globalThis.Worker = class extends EventTarget {
    postMessage() {}
  };
  globalThis.addEventListener = () => {};
  const { Leases } = await import("../page/js/leases.js");
  leases = new Leases({ on: () => {} }, {}, 10);
  await leases.heat("bench", { command: "power", power_w: 900 });
  requests.length = 0;
});

const pass = (seconds) => {
  now_ms += 1000 * seconds;
  mock.timers.tick(500);
};

test("a clock that is set ends no heating", () => {
  mock.method(Date, "now", () => 2e12);
  pass(1);
  assert.deepEqual([leases.state("bench").phase, requests], ["held", []]);
});

test("a lease that nothing has renewed for its length is given back", () => {
  pass(10.5);
  assert.deepEqual([leases.state("bench").phase, requests], ["lost", ["DELETE lease"]]);
});

test("a page that is left waits until its leases are given back", async () => {
  await leases.releaseAll("you logged out", {});
  assert.deepEqual([leases.heated(), requests], [[], ["DELETE lease"]]);
});

/** Runs what waits for answers until nothing does. */
const settle = () => new Promise((done) => setImmediate(done));

test("a second power that overtakes the first is the one that is shown and held", async () => {
  const answers = [];
  mock.method(globalThis, "fetch", (url, { method }) => {
    requests.push(`${method} ${new URL(url).pathname.split("/").at(-1)}`);
    return new Promise((answer) => answers.push(() => answer(new Response("{}", { status: 200 }))));
  });
  const posted = [];
  leases.worker.postMessage = ({ type, device }) => posted.push(`${type} ${device}`);
  const first = leases.heat("hall", { command: "power", power_w: 500 });
  const second = leases.heat("hall", { command: "power", power_w: 1500 });
  const refused = assert.rejects(first, /set anew/);
  answers.shift()();
  await refused;
  while (answers.length) {
    answers.shift()();
    await settle();
  }
  await second;
  const { phase, power_w } = leases.state("hall");
  assert.deepEqual([phase, power_w, posted], ["held", 1500, ["hold hall"]]);
  assert.deepEqual(requests, ["PUT lease", "PUT lease", "POST commands"]);
});

test("a lease that is renewed for a device which the page does not heat is dropped", () => {
  const posted = [];
  leases.worker.postMessage = ({ type, device }) => posted.push(`${type} ${device}`);
  leases.worker.dispatchEvent(new MessageEvent("message", { data: { device: "hall", ok: true, asked_ms: 0 } }));
  assert.deepEqual(posted, ["drop hall"]);
});
