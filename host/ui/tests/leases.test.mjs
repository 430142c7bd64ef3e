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
