// What the fake daemon holds: hobs, journal, recordings, and what is asked of them.

import { EventEmitter } from 'node:events';

import { Fleet } from './fleet.mjs';
import { FAULTS, Hob, LEASE_MS, past } from './hob.mjs';
import { Lookups } from './lookups.mjs';
import { POTS, RATED_W } from './pot.mjs';
import { verdict } from './windows.mjs';

const NAMES = ['bench', 'desk', 'lab-3', 'kitchen'];
const JOURNAL_LENGTH = 20000;

/** A refusal with the status and the word of the API. */
export class Refusal extends Error {
  constructor(status, error, message, fields = {}) {
    super(message);
    Object.assign(this, { status, error, fields });
  }
}

export class Daemon extends EventEmitter {
  constructor({ devices, fleet, rate, historyS, heating, seed }) {
    super();
    this.setMaxListeners(0);
    this.startMs = Date.now();
    this.journal = [];
    this.fleet = new Fleet({ devices: fleet, seed });
    this.recordings = [];
    /** Stretches in which nobody listened: [fromMs, toMs]. */
    this.silent = [];
    this.down = false;
    const nowMs = this.startMs;
    this.hobs = Array.from({ length: devices }, (_, k) => this.hob(k, { rate, historyS, heating, seed }, nowMs));
    this.journal.sort((a, b) => a.at_ms - b.at_ms);
    for (const [k, hob] of this.hobs.entries()) this.recordings.push(oldRecording(hob, nowMs - 600e3 * (k + 1)));
    this.timer = setInterval(() => this.tick(Date.now()), 50);
  }

  hob(k, { rate, historyS, heating, seed }, nowMs) {
    const name = NAMES[k] ?? `hob-${k}`;
    const fromMs = nowMs - historyS * 1000;
    const hob = new Hob(name, `2039${(0x344e5956 + k * 0x11d).toString(16).toUpperCase()}`, seed + k, rate, fromMs);
    hob.pot0 = Object.keys(POTS)[k % 4];
    hob.lookups = new Lookups(hob);
    const note = (...what) => this.note(...what);
    if (historyS > 90) past(hob, fromMs, nowMs, note);
    for (let version = 5; version > 0; version--) hob.lookups.learn(nowMs - version * 300e3);
    if (k === 1) hob.lookups.refuse('lookup-slope: neighbouring cells differ by more than 1.6', nowMs - 200e3);
    // The first waits for whoever looks at the page; the others are heated at their panels.
    const panel = [0, 1500, 2200, 900][k % 4];
    hob.change({ askedW: heating ? 700 + 300 * (k % 4) : panel, pot: hob.pot0, fault: 0 }, nowMs - 25000);
    if (k % 4 === 3 && !heating) hob.change({ pot: null }, nowMs - 9000);
    hob.sinceMs = nowMs - 25000;
    hob.told = hob.newestSeq(nowMs);
    return hob;
  }

  named(name) {
    const hob = this.hobs.find((h) => h.name === name);
    if (!hob) throw new Refusal(404, 'no-device', `there is no device ${JSON.stringify(name)}; \`ihd device list\` shows those that there are`, { name });
    return hob;
  }

  note(atMs, device, kind, text, holder = '') {
    this.journal.push({ at_ms: Math.round(atMs), device, kind, holder, text });
    if (this.journal.length > JOURNAL_LENGTH) this.journal.splice(0, 1000);
  }

  /** Tells everybody who watches. */
  tell(hob, event, what) {
    if (!this.down) this.emit('notice', { at_ms: Date.now(), device: hob?.name ?? '', event, ...what });
  }

  tick(nowMs) {
    for (const hob of this.hobs) {
      hob.tick(nowMs, (event, what) => this.tell(hob, event, what));
      const [state, detail] = hob.deviceState();
      if (state !== hob.toldState) {
        hob.sinceMs = nowMs;
        if (hob.toldState !== undefined) this.tell(hob, 'state', { state, detail });
        hob.toldState = state;
      }
      for (; hob.told < hob.newestSeq(nowMs); hob.told++) this.window(hob, hob.told + 1, nowMs);
      this.record(hob, nowMs);
    }
  }

  window(hob, seq, nowMs) {
    const window = hob.connected ? hob.windowOf(seq) : null;
    if (!window) return;
    this.tell(hob, 'window-stored', { boot: hob.boot, seq });
    const { pass, why, r_ohm, l_h } = verdict(hob, window);
    this.tell(hob, 'result-stored', { boot: hob.boot, seq, f_sw_hz: window.fSw, r_ohm, l_h, pass, why });
    if (pass && seq % 80 === 0) {
      const made = hob.lookups.learn(nowMs);
      this.tell(hob, 'lookup-active', { version: made.version, observed_cells: made.observed.flat().filter(Boolean).length });
    }
  }

  report(hob, nowMs = Date.now()) {
    const [state, detail] = hob.deviceState();
    const windows = Math.max(0, hob.newestSeq(nowMs));
    const active = hob.lookups.active;
    const lease = hob.lease && { holder: hob.lease.holder, expires_in_s: Math.ceil((hob.lease.untilMs - nowMs) / 1000) };
    return {
      name: hob.name,
      address: hob.name === 'desk' ? 'sim' : `tcp:127.0.0.1:${4711 + hob.seed}`,
      serial: hob.serial,
      state,
      since_s: Math.floor((nowMs - hob.sinceMs) / 1000),
      detail: hob.detailSaid ?? detail,
      identity: { build: hob.buildSaid ?? 'ihd 0.9.0 (fake)', board: 'simulated', protocol: [2, 6], boot_id: hob.boot, reset_reason: 0 },
      updates_needed: hob.incompatible ? detail : '',
      live: hob.live(hob.connected ? nowMs : hob.lostMs),
      lookup: {
        on_device: active?.version ?? 0,
        active: active?.version ?? null,
        pending: null,
        observed_cells: active ? active.observed.flat().filter(Boolean).length : 0,
      },
      windows: { announced: windows, stored: windows - 3, refused: 1, dropped_by_device: 1, lost: 1, not_stored: 0, learned: windows - 3, unfit: 0, unlearned: 0 },
      asked_by_daemon_w: hob.askedByDaemonW,
      lease,
      sweep_left_w: hob.sweep,
      sweep_is_complete: false,
      recording: hob.recording?.file ?? null,
      recording_now: hob.recording && { settings: hob.recording.settings, file: hob.recording.file, since_s: (nowMs - hob.recording.sinceMs) / 1000 },
      pot_temperature: null,
      connections: hob.connections,
    };
  }

  takeLease(hob, holder, force, nowMs = Date.now()) {
    const held = hob.lease;
    if (held && held.holder !== holder && !force) {
      const left = Math.ceil((held.untilMs - nowMs) / 1000);
      throw new Refusal(423, 'leased', `${held.holder} commands ${hob.name}, for ${left} s more unless it is renewed; --force takes it over`, { name: hob.name, holder: held.holder, expires_in_s: left });
    }
    const takenFrom = held && held.holder !== holder ? held.holder : '';
    hob.lease = { holder, untilMs: nowMs + LEASE_MS };
    if (takenFrom) hob.off(nowMs, (...what) => this.tell(hob, ...what), `${holder} has taken the lease from ${takenFrom}`);
    if (takenFrom || !held) this.tell(hob, 'lease', { holder, taken_from: takenFrom });
    return { holder, expires_in_s: LEASE_MS / 1000 };
  }

  releaseLease(hob, holder) {
    if (hob.lease?.holder === holder) {
      hob.lease = null;
      this.tell(hob, 'lease', { holder: '', taken_from: '' });
      hob.off(Date.now(), (...what) => this.tell(hob, ...what), `${holder} has given the lease back`);
    } else if (hob.lease) {
      this.takeLease(hob, holder, false);
    }
  }

  /** Carries out a command; what became of it. */
  command(hob, holder, body) {
    const nowMs = Date.now();
    if (!hob.connected) throw new Refusal(503, 'not-connected', `${hob.name} is not connected: ${hob.deviceState()[1]}`, { name: hob.name });
    const refused = (why) => {
      this.note(nowMs, hob.name, 'command', `${body.command}: refused: ${why}`, holder);
      this.tell(hob, 'command', { holder, text: body.command, ok: false });
      return new Refusal(409, 'refused', `${hob.name}: ${why}`, { name: hob.name, why });
    };
    if (body.command !== 'off') {
      const free = !hob.lease;
      this.takeLease(hob, holder, false);
      if (free && !['power', 'sweep'].includes(body.command)) hob.lease = null;
    }
    let done;
    try {
      done = this.carryOut(hob, body, nowMs);
    } catch (error) {
      throw error instanceof Refusal ? error : refused(error.message);
    }
    this.note(nowMs, hob.name, 'command', `${body.command}: ${done.text}`, holder);
    this.tell(hob, 'command', { holder, text: `${body.command}: ${done.text}`, ok: true });
    return { file: null, ...done };
  }

  carryOut(hob, body, nowMs) {
    const tell = (...what) => this.tell(hob, ...what);
    switch (body.command) {
      case 'off':
        hob.off(nowMs, tell, 'switched off');
        return { text: 'off' };
      case 'power':
        if (!Number.isInteger(body.power_w) || body.power_w < 0) throw new Refusal(422, 'body', 'power_w: a whole number of watt');
        if (body.power_w > 10_000) throw new Error(`${body.power_w} W is more than may be asked of it: 10000 W`);
        if (body.power_w === 0) {
          hob.off(nowMs, tell, 'switched off');
          return { text: 'off', granted_w: null };
        }
        hob.heat(Math.min(body.power_w, RATED_W), nowMs);
        return body.power_w > RATED_W
          ? { text: `${body.power_w} W asked, ${RATED_W} W is the most this hob gives`, granted_w: RATED_W }
          : { text: `${body.power_w} W asked for`, granted_w: body.power_w };
      case 'sweep':
        if (!body.powers_w?.length || body.powers_w.length > 64) throw new Error('a sweep has 1 to 64 powers');
        hob.sweep = [...body.powers_w];
        hob.sweepNextMs = nowMs + 3000;
        hob.heat(hob.sweep[0], nowMs);
        return { text: `sweep through ${body.powers_w.length} powers begun; it ends with the lease` };
      case 'clear-fault':
        if (!hob.now.fault) throw new Error('there is no fault to clear');
        hob.change({ fault: 0, askedW: 0 }, nowMs);
        tell('fault', { fault: 0, text: 'no fault' });
        return { text: 'fault cleared' };
      case 'lookup-push':
        return this.useLookup(hob, hob.lookups.push(body.blob ?? [], nowMs));
      case 'lookup-rollback': {
        const old = hob.lookups.wanted(body.version);
        if (!old) throw new Error(body.version ? `the store holds no version ${body.version} that was active` : 'the store holds no lookup that was active before');
        return this.useLookup(hob, hob.lookups.activate({ ...old, why: `rolled back to version ${old.version}` }, nowMs));
      }
      case 'lookup-reset':
        hob.lookups.reset();
        tell('lookup-active', { version: 0, observed_cells: 0 });
        return { text: 'back to the built-in lookup; what was learned is forgotten' };
      case 'record-start':
        return this.startRecording(hob, body, nowMs);
      case 'record-stop':
        if (!hob.recording) throw new Error('nothing is being recorded');
        return { text: 'recorded', file: this.stopRecording(hob, nowMs) };
      default:
        throw new Refusal(422, 'body', `command: unknown variant \`${body.command}\``);
    }
  }

  useLookup(hob, made) {
    this.tell(hob, 'lookup-active', { version: made.version, observed_cells: made.observed.flat().filter(Boolean).length });
    return { text: `version ${made.version} is active` };
  }

  startRecording(hob, { command: _, ...settings }, nowMs) {
    if (hob.recording) throw new Error(`it is being recorded into ${hob.recording.file ?? 'a file, once its trigger comes'}`);
    const full = { trigger: { on: 'now' }, pre_trigger_s: 0, duration_s: null, ...settings };
    hob.recording = { settings: full, file: null, sinceMs: nowMs };
    if (full.trigger.on === 'now') this.trigger(hob, nowMs);
    return { text: hob.recording.file ? 'recording' : 'waiting for the trigger', file: hob.recording.file };
  }

  trigger(hob, nowMs) {
    const stamp = new Date(nowMs).toISOString().replace(/[-:]/g, '').replace('T', '-').slice(0, 15);
    const file = `${hob.name}-${stamp}.mcap`;
    Object.assign(hob.recording, { file, sinceMs: nowMs });
    this.recordings.push({ file, device: hob.name, at_ms: nowMs, bytes: 4096, under_way: true });
  }

  record(hob, nowMs) {
    const now = hob.recording;
    if (!now) return;
    if (!now.file) {
      const { on, quantity, level, rising } = now.settings.trigger;
      const half = hob.halfCycle(hob.number(nowMs));
      const value = { power: half.powerW, current: half.iCrestA, resistance: half.rOhm, inductance: half.lH === null ? null : half.lH * 1e6, frequency: half.fSwHz / 1e3 }[quantity];
      const before = now.last;
      now.last = value;
      const crossed = on === 'level' && value !== null && typeof before === 'number' && (rising ? before < level && value >= level : before > level && value <= level);
      if (crossed || (on === 'fault' && half.fault)) this.trigger(hob, nowMs);
      return;
    }
    const file = this.recordings.find((r) => r.file === now.file);
    Object.assign(file, { bytes: Math.round(4096 + 90 * (nowMs - now.sinceMs)), at_ms: nowMs });
    if (now.settings.duration_s && nowMs - now.sinceMs >= now.settings.duration_s * 1000) this.stopRecording(hob, nowMs);
  }

  stopRecording(hob, nowMs) {
    const { file } = hob.recording;
    hob.recording = null;
    const written = this.recordings.find((r) => r.file === file);
    if (written) Object.assign(written, { under_way: false, at_ms: nowMs });
    return file;
  }

  fault(hob, number, nowMs = Date.now()) {
    hob.change({ fault: number }, nowMs);
    const text = FAULTS[number] ?? `fault ${number}`;
    this.note(nowMs, hob.name, 'fault', `fault ${number}: ${text}`);
    this.tell(hob, 'fault', { fault: number, text });
  }
}

function oldRecording(hob, atMs) {
  const stamp = new Date(atMs).toISOString().replace(/[-:]/g, '').replace('T', '-').slice(0, 15);
  return { file: `${hob.name}-${stamp}.mcap`, device: hob.name, at_ms: Math.round(atMs), bytes: 3_500_000 + 1000 * hob.seed, under_way: false };
}
