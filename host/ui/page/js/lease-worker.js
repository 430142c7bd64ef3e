// @ts-check
/**
 * Renews leases every 3 s, in a worker, because timers of hidden tabs are throttled to one a minute.
 *
 * It does so only while the page answers its pings: a page that hangs does not heat. After {@link PATIENCE_MS} of
 * silence the worker gives the leases back, which switches the hobs off; when the whole tab is gone so is the
 * worker, and the lease ends by itself, at most 10 s after its last renewal.
 */

import { pageAlive, steady_ms } from "./lease-machine.js";

const RENEW_MS = 3000;
const PING_MS = 500;
const PATIENCE_MS = 4000;
/** A slow link is no lost one: an answer may take two renewals. */
const REQUEST_MS = 6000;
const MAX_UNDER_WAY = 2;

/** @type {Map<string, {url: string, holder: string, next_ms: number, underWay: number}>} */
const leases = new Map();
let answered_ms = performance.now();

self.addEventListener("message", (event) => {
  const told = event.data;
  answered_ms = performance.now();
  if (told.type === "hold") {
    const known = leases.get(told.device);
    leases.set(told.device, { url: told.url, holder: told.holder, next_ms: known?.next_ms ?? answered_ms + RENEW_MS, underWay: known?.underWay ?? 0 });
  } else if (told.type === "drop") {
    leases.delete(told.device);
  }
});

setInterval(() => {
  if (leases.size === 0) return;
  self.postMessage({ type: "ping" });
  const now = performance.now();
  if (!pageAlive(answered_ms, now, PATIENCE_MS)) {
    for (const [device, lease] of leases) giveBack(device, lease);
    return;
  }
  for (const [device, lease] of leases) {
    if (now >= lease.next_ms && lease.underWay < MAX_UNDER_WAY) renew(device, lease);
  }
}, PING_MS);

/**
 * @param {string} device
 * @param {{url: string, holder: string, next_ms: number, underWay: number}} lease
 */
async function renew(device, lease) {
  lease.underWay += 1;
  lease.next_ms = performance.now() + RENEW_MS;
  const asked_ms = steady_ms();
  try {
    const response = await fetch(lease.url, {
      method: "PUT",
      headers: { "ihd-holder": lease.holder, "content-type": "application/json" },
      body: '{"force":false}',
      signal: AbortSignal.timeout(REQUEST_MS),
    });
    const answer = await response.json().catch(() => ({}));
    if (leases.get(device) !== lease) return;
    if (!response.ok) lease.next_ms = performance.now() + RENEW_MS / 3;
    self.postMessage({ type: "renewal", device, ok: response.ok, status: response.status, answer, asked_ms });
  } catch (why) {
    lease.next_ms = performance.now() + RENEW_MS / 6;
    self.postMessage({ type: "renewal", device, ok: false, status: 0, answer: { message: String(why) }, asked_ms });
  } finally {
    lease.underWay -= 1;
  }
}

/**
 * The page is silent: its hobs go off.
 * @param {string} device
 * @param {{url: string, holder: string}} lease
 */
async function giveBack(device, lease) {
  leases.delete(device);
  try {
    await fetch(lease.url, { method: "DELETE", headers: { "ihd-holder": lease.holder }, keepalive: true });
  } catch {
    // The lease ends by itself.
  }
  self.postMessage({ type: "given-back", device });
}
