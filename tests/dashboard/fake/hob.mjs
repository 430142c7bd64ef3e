// A hob of the fake daemon: what it did since its history began, what it does, and who commands it.
//
// Its past is a list of stretches in each of which the same was asked of it with the same pot. What a half-cycle measured
// follows from its stretch, its number and the seed alone, so that history and live stream tell the same.

import { F_MAX_HZ, POTS } from './pot.mjs';
import { normal, uniform } from './random.mjs';

/** Half-cycles from one window to the next. */
const WINDOW_EVERY = 25;
/** A pot warms up with this time constant, in seconds, and its R grows by this share. */
const WARMING_S = 240;
const WARMING_SHARE = 0.08;
/** What a soft start lowers the frequency by, per half-cycle, in hertz. */
const RAMP_HZ = 2500;
export const LEASE_MS = 10000;

export const FAULTS = {
  4: 'coil current at the trip level; ask for less power, or check the current sensor',
  17: 'coil voltage, coil current and bus voltage contradict each other; check gain and wiring of the three sensors, and the resonance capacitor',
  24: 'heat sink, glass or coil is too hot; let it cool down, and check fan and air inlets',
};

/**
 * @typedef {object} Stretch
 * @property {number} fromMs
 * @property {number} askedW
 * @property {string | null} pot  a name of POTS, null for none
 * @property {number} fault
 * @property {number} warm0  warmth at its beginning, 0 to 1
 */

export class Hob {
  constructor(name, serial, seed, rate, bootMs) {
    this.name = name;
    this.serial = serial;
    this.seed = seed;
    this.rate = rate;
    this.bootMs = bootMs;
    this.boot = 1000 + seed;
    /** @type {Stretch[]} */
    this.stretches = [{ fromMs: bootMs, askedW: 0, pot: 'ferritic-21', fault: 0, warm0: 0 }];
    this.connected = true;
    this.askedByDaemonW = 0;
    this.lease = null;
    this.sweep = [];
    this.recording = null;
    this.connections = 1;
    this.sinceMs = bootMs;
    this.incompatible = false;
  }

  get periodMs() {
    return 1000 / this.rate;
  }

  number(atMs) {
    return Math.floor((atMs - this.bootMs) / this.periodMs);
  }

  /** The stretch of a time; the first for what was before. */
  stretch(atMs) {
    let [low, high] = [0, this.stretches.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.stretches[middle].fromMs <= atMs) low = middle;
      else high = middle - 1;
    }
    return this.stretches[low];
  }

  static heats(stretch) {
    return stretch.askedW > 0 && stretch.pot !== null && stretch.fault === 0;
  }

  warmth(stretch, atMs) {
    const target = Hob.heats(stretch) ? 1 : 0;
    const gone = Math.exp(-Math.max(0, atMs - stretch.fromMs) / 1000 / WARMING_S);
    return target + (stretch.warm0 - target) * gone;
  }

  /** Begins another stretch. */
  change(what, atMs = Date.now()) {
    const last = this.stretches[this.stretches.length - 1];
    const next = { ...last, ...what, fromMs: atMs, warm0: this.warmth(last, atMs) };
    if (what.pot !== undefined && what.pot !== last.pot && what.pot !== null) next.warm0 = 0;
    this.stretches.push(next);
  }

  get now() {
    return this.stretches[this.stretches.length - 1];
  }

  /** What was true in half-cycle `n`: before anybody measured it. */
  truth(n) {
    const atMs = this.bootMs + n * this.periodMs;
    const stretch = this.stretch(atMs);
    if (!Hob.heats(stretch)) return { stretch, atMs, heats: false };
    const pot = POTS[stretch.pot];
    const warm = 1 + WARMING_SHARE * Number(this.warmth(stretch, atMs).toFixed(2));
    let now = pot.heat(stretch.askedW, warm);
    const since = n - this.number(stretch.fromMs);
    const start = F_MAX_HZ - RAMP_HZ * since;
    if (start > now.fSw && stretch.ramp !== false) now = { fSw: start, ...pot.halfCycle(start, warm) };
    // Below the least power at the highest frequency it heats in bursts.
    const share = now.fSw >= F_MAX_HZ ? Math.min(1, stretch.askedW / now.power) : 1;
    const heats = Math.floor((n + 1) * share) > Math.floor(n * share);
    return { stretch, atMs, heats, pot, warm, ...now };
  }

  /** What half-cycle `n` measured. */
  halfCycle(n) {
    const t = this.truth(n);
    const noise = (k) => normal(this.seed * 7 + k, n);
    const on = t.heats;
    return {
      n,
      atMs: t.atMs,
      state: word(t.stretch, on || Hob.heats(t.stretch)),
      pot: t.stretch.pot === null ? 'Absent' : 'Ferromagnetic',
      fault: t.stretch.fault,
      askedW: t.stretch.askedW,
      powerW: on ? t.power * (1 + 0.006 * noise(1)) : 0,
      fSwHz: on ? t.fSw : 0,
      iCrestA: on ? t.i * (1 + 0.002 * noise(2)) : 0,
      rOhm: on ? t.r * (1 + 0.004 * noise(3)) : null,
      lH: on ? t.l * (1 + 0.0015 * noise(4)) : null,
    };
  }

  live(atMs = Date.now()) {
    const h = this.halfCycle(this.number(atMs));
    return {
      half_cycle: h.n,
      state: h.state,
      pot: h.pot,
      fault: h.fault,
      fault_text: h.fault ? FAULTS[h.fault] ?? `fault ${h.fault}` : '',
      limit: h.fSwHz && h.fSwHz < 36000 ? 'Resonance' : 'None',
      asked_w: h.askedW,
      power_w: h.powerW,
      f_sw_hz: h.fSwHz,
      i_crest_a: h.iCrestA,
      r_ohm: h.rOhm ?? 0,
      l_h: h.lH ?? 0,
      glass_hot: false,
    };
  }

  /** What it is to the daemon, and why. */
  deviceState() {
    if (this.incompatible) return ['incompatible', 'it speaks protocol 1.4 and this build 2.6: update the firmware'];
    if (!this.connected) return ['searching', `nobody answers at tcp:127.0.0.1:${4711 + this.seed}`];
    const now = this.now;
    if (now.fault) return ['faulted', FAULTS[now.fault] ?? `fault ${now.fault}`];
    if (now.askedW && now.pot === null) return ['waiting-for-pot', 'put a pot on'];
    return now.askedW ? ['learning', ''] : ['idle', ''];
  }

  /** Number of the newest window before a half-cycle, or null where it was not heating. */
  windowOf(seq) {
    if (seq < 0) return null;
    const n = seq * WINDOW_EVERY;
    const t = this.truth(n);
    // A window holds whole periods at one frequency: none while the frequency ramps or in a burst's pause.
    return t.heats && t.pot.heat(t.stretch.askedW, t.warm).fSw === t.fSw ? { seq, n, ...t } : null;
  }

  newestSeq(atMs = Date.now()) {
    return Math.floor((this.number(atMs) - 1) / WINDOW_EVERY);
  }

  /** Windows, newest first. */
  windows(limit, atMs = Date.now()) {
    const found = [];
    for (let seq = this.newestSeq(atMs); seq >= 0 && found.length < limit; seq--) {
      const window = this.windowOf(seq);
      if (window) found.push(window);
    }
    return found;
  }

  /** Ends a lease that has run out; what it heated with it. */
  tick(nowMs, tell) {
    if (this.lease && this.lease.untilMs <= nowMs) {
      this.lease = null;
      tell('lease', { holder: '', taken_from: '' });
      if (this.askedByDaemonW || this.sweep.length) this.off(nowMs, tell, 'the lease ran out');
    }
    if (this.sweep.length && nowMs >= this.sweepNextMs) {
      this.sweep.shift();
      if (this.sweep.length) this.heat(this.sweep[0], nowMs);
      else this.off(nowMs, tell, 'the sweep is over');
      this.sweepNextMs = nowMs + 3000;
    }
  }

  heat(powerW, nowMs = Date.now()) {
    this.askedByDaemonW = powerW;
    this.change({ askedW: powerW }, nowMs);
  }

  off(nowMs, tell, why) {
    this.askedByDaemonW = 0;
    this.sweep = [];
    if (this.now.askedW) this.change({ askedW: 0 }, nowMs);
    tell('state', { state: this.deviceState()[0], detail: why });
  }
}

function word(stretch, heats) {
  if (stretch.fault) return 'Idle';
  if (heats) return 'Heating';
  return stretch.askedW && stretch.pot === null ? 'WaitingForPot' : 'Idle';
}

/** A past for a hob: powers, pauses, a pot that was lifted, a fault; ends with what it does now. */
export function past(hob, fromMs, nowMs, note) {
  let at = fromMs;
  for (let k = 0; at < nowMs - 40000; k++) {
    const dice = (j) => uniform(hob.seed * 31 + j, k);
    const askedW = dice(0) < 0.2 ? 0 : 500 + 100 * Math.floor(dice(1) * 18);
    hob.change({ askedW, pot: hob.pot0, fault: 0 }, at);
    note(at, hob.name, 'state', askedW ? `learning: ${askedW} W asked for at the panel` : 'idle');
    const lengthMs = Math.min(60000 + 240000 * dice(2), nowMs - 30000 - at);
    if (dice(3) < 0.35 && askedW && lengthMs > 60000) {
      const lifted = at + lengthMs * 0.6;
      hob.change({ pot: null }, lifted);
      note(lifted, hob.name, 'pot', 'the pot was taken away');
      hob.change({ pot: hob.pot0 }, lifted + 8000);
      note(lifted + 8000, hob.name, 'pot', 'a pot stands on the coil');
    } else if (dice(3) > 0.85 && askedW && lengthMs > 60000) {
      const tripped = at + lengthMs * 0.7;
      hob.change({ fault: 24 }, tripped);
      note(tripped, hob.name, 'fault', `fault 24: ${FAULTS[24]}`);
      hob.change({ fault: 0, askedW: 0 }, tripped + 25000);
      note(tripped + 25000, hob.name, 'command', 'clear-fault: fault cleared', 'ada');
    }
    at += Math.max(lengthMs, 1000);
  }
}
