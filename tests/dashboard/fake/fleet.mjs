// The fleet that the fake daemon is an edge of: hobs of many edges, some workers, and numbers that go on.

import { hash, uniform } from './random.mjs';

const STATES = ['idle', 'learning', 'learning', 'waiting-for-pot', 'searching', 'faulted'];
const POTS = ['Ferromagnetic', 'Absent', 'Unknown', ''];
/** Hobs of an edge. */
const HOBS = 8;
/** Of the cards of edges and workers, in milliseconds. */
const RENEWED_MS = 10e3;

export class Fleet {
  /** @param {{devices: number, seed: number}} of `devices` 0: the daemon is no edge */
  constructor({ devices, seed }) {
    this.seed = seed;
    this.startMs = Date.now();
    this.connected = true;
    this.why = '';
    /** What needs somebody at this edge. */
    this.alarms = [];
    /** What hostile machines call themselves: `{names, build}` of the first devices, edges and workers. */
    this.words = null;
    this.size = devices;
  }

  /** Heard of lately, each at a time of its own; every twentieth has been silent for hours. */
  seenMs(k, nowMs) {
    if (k % 20 === 7) return this.startMs - 1000 * (3600 + (hash(this.seed, k) % 36000));
    const at = hash(this.seed + 1, k) % RENEWED_MS;
    return nowMs - ((nowMs + at) % RENEWED_MS);
  }

  device(k, nowMs) {
    const edge = Math.floor(k / HOBS);
    const outdated = hash(this.seed + 2, k) % 9 === 0;
    const silent = k % 20 === 7;
    return {
      name: `hob-${k}`,
      edge: `kitchen-${edge}`,
      state: silent ? 'searching' : STATES[hash(this.seed + 3, k) % STATES.length],
      pot: POTS[hash(this.seed + 4, k) % POTS.length],
      build: outdated ? 'ihd 0.8.2' : 'ihd 0.9.0 (fake)',
      protocol: outdated ? [2, 5] : [2, 6],
      lookup_version: hash(this.seed + 5, k) % 40,
      outdated,
      last_seen_ms: this.seenMs(k, nowMs),
    };
  }

  report() {
    if (this.size === 0) return null;
    const nowMs = this.connected ? Date.now() : this.lostMs;
    const seconds = (nowMs - this.startMs) / 1000;
    const windows = 48211 + Math.floor(5 * seconds);
    const backlog = 12 + Math.floor(9 * uniform(this.seed, Math.floor(seconds / 2)));
    const devices = Array.from({ length: this.size }, (_, k) => this.device(k, nowMs));
    const edges = Array.from({ length: Math.ceil(this.size / HOBS) }, (_, k) => ({
      name: `kitchen-${k}`, version: '0.1.0', outbox: k % 7 === 3 ? 4 : 0, trusts_fleet: k % 11 !== 5, alarms: [], last_seen_ms: this.seenMs(20 * k, nowMs),
    }));
    const workers = Array.from({ length: 4 }, (_, k) => ({
      name: `worker-${k}`, version: '0.1.0', threads: 2, busy: k % 3, done: 12000 - 900 * k, failed: k === 2 ? 3 : 0, last_seen_ms: this.seenMs(20 * k + 1, nowMs),
    }));
    if (this.words) {
      const { names, build } = this.words;
      for (const [k, name] of names.entries()) {
        Object.assign(devices[k], { name, build, state: name, pot: name, edge: name });
        Object.assign(edges[k], { name, version: build });
        Object.assign(workers[k], { name, version: build });
      }
    }
    const outbox = this.connected ? 0 : 5 * Math.floor((Date.now() - nowMs) / 1000);
    const states = { not_for_fleet: 100, due: outbox, sent: backlog, answered: windows - backlog - 40, learned_here: 39, no_samples: 0, dead: 1, due_since_ms: null, sent_since_ms: null };
    return {
      server: 'tls://nats.example:4222', edge: 'kitchen-0', connected: this.connected, why: this.why, at_ms: nowMs,
      outbox, states, alarms: this.alarms, windows, results: windows - backlog - 1, backlog, dead: 1, workers, edges, devices,
    };
  }

  /** `POST /fake/fleet`: whether the server answers and why not, how many hobs there are, what they call themselves. */
  change({ connected, why, devices, words, alarms }) {
    if (connected !== undefined) Object.assign(this, { connected, why: why ?? '', lostMs: Date.now() });
    if (devices !== undefined) this.size = devices;
    if (words !== undefined) this.words = words;
    if (alarms !== undefined) this.alarms = alarms;
    return { connected: this.connected, devices: this.size };
  }
}
