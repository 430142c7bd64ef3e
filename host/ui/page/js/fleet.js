// @ts-check
/** What is known of each device now: newest report, newest telemetry, newest result of the network. */

import { heats } from "./telemetry.js";

/** How long after its window a result of the network stands for now, in milliseconds. */
export const RESULT_LASTS_MS = 10_000;
/** How far, as a share, the frequency of now may be from the window's: R grows about as the frequency does. */
export const SAME_FREQUENCY = 0.01;
/** A window may be ahead of the clock that the last telemetry told by so much, in milliseconds. */
const AHEAD_MS = 1000;
/** Windows of a device whose times are kept: more than ten seconds of them. */
const WINDOWS_KEPT = 128;

/** States in which the last half-cycle is none of now. */
const SILENT = new Set(["searching", "suspended", "incompatible"]);

/**
 * @typedef {{at_ms: number, boot: number, seq: number, f_sw_hz: number, r_ohm: number, l_h: number, pass: boolean,
 *   why: string}} Result at_ms: when it was stored
 * @typedef {{r_ohm: number | null, l_h: number | null, source: "network" | "device" | "none", at_ms: number,
 *   window: {boot: number, seq: number} | null}} Now at_ms: when its window was stored, or the half-cycle was heard of
 */

export class Fleet {
  /** @param {import("./stream.js").Stream} stream */
  constructor(stream) {
    this.stream = stream;
    /** @type {Map<string, any>} newest reports by name, in the daemon's order */
    this.reports = new Map();
    /** @type {Map<string, import("./telemetry.js").DeviceTelemetry>} */
    this.telemetry = new Map();
    /** When each was heard last, by the page's clock. @type {Map<string, number>} */
    this.heard_ms = new Map();
    /** The result of the newest window that the gate let pass. @type {Map<string, Result & {taken_ms: number}>} */
    this.results = new Map();
    /** Time of the last telemetry. */
    this.at_ms = 0;
    /** When the last windows of each were stored, by boot and number. @type {Map<string, Map<string, number>>} */
    this.windows = new Map();
    stream.on("devices", (reports) => this.setReports(reports));
    stream.on("telemetry", (event) => {
      // The daemon's clock was set back: times of before are none of now.
      if (event.at_ms < this.at_ms) for (const map of [this.results, this.windows]) map.clear();
      this.at_ms = event.at_ms;
      for (const [name, one] of Object.entries(event.devices)) {
        if (!this.reports.has(name) && this.reports.size > 0) continue;
        this.telemetry.set(name, one);
        if (one.half_cycles > 0) this.heard_ms.set(name, performance.now());
      }
    });
    stream.on("notice", (notice) => this.#notice(notice));
  }

  /** @param {any[]} reports */
  setReports(reports) {
    this.reports = new Map(reports.map((report) => [report.name, report]));
    for (const map of [this.telemetry, this.heard_ms, this.results, this.windows]) {
      for (const name of map.keys()) if (!this.reports.has(name)) map.delete(name);
    }
  }

  /** @returns {string[]} */
  names() {
    return [...this.reports.keys()];
  }

  /**
   * Its last half-cycle: of the telemetry, or of the report where that is all there is.
   * @param {string} name
   * @returns {import("./telemetry.js").Live | null}
   */
  live(name) {
    const report = this.reports.get(name);
    if (report && SILENT.has(report.state)) return null;
    return this.telemetry.get(name)?.last ?? report?.live ?? null;
  }

  /**
   * A window of a device.
   * @param {string} name
   * @param {{boot: number, seq: number, at_ms: number}} window
   */
  addWindow(name, { boot, seq, at_ms }) {
    const times = this.windows.get(name) ?? new Map();
    times.set(`${boot}/${seq}`, at_ms);
    if (times.size > WINDOWS_KEPT) times.delete(times.keys().next().value);
    this.windows.set(name, times);
  }

  /**
   * A result. It is as old as its window, however late it came; a window that was never heard of is too old to tell of now, and one that
   * lies ahead is of before the clock was set back.
   * @param {string} name
   * @param {Result} result
   */
  addResult(name, result) {
    const taken_ms = this.windows.get(name)?.get(`${result.boot}/${result.seq}`);
    if (!result.pass || taken_ms === undefined || taken_ms > this.stream.daemonNow_ms() + AHEAD_MS) return;
    const known = this.results.get(name);
    if (!known || known.taken_ms <= taken_ms) this.results.set(name, { ...result, taken_ms });
  }

  /**
   * R and L now: the network's of the last window that passed, where it is younger than 10 s and of the frequency of now;
   * else the device's own.
   * @param {string} name
   * @returns {Now}
   */
  now(name) {
    const live = this.live(name);
    if (!live || !heats(live)) return { r_ohm: null, l_h: null, source: "none", at_ms: 0, window: null };
    const result = this.results.get(name);
    if (result && this.stream.daemonNow_ms() - result.taken_ms < RESULT_LASTS_MS
      && Math.abs(result.f_sw_hz / live.f_sw_hz - 1) <= SAME_FREQUENCY) {
      const { boot, seq } = result;
      return { r_ohm: result.r_ohm, l_h: result.l_h, source: "network", at_ms: result.taken_ms, window: { boot, seq } };
    }
    return { r_ohm: live.r_ohm, l_h: live.l_h, source: "device", at_ms: this.stream.lastAt_ms, window: null };
  }

  /** @param {any} notice */
  #notice(notice) {
    if (notice.event === "window-stored") this.addWindow(notice.device, notice);
    if (notice.event === "result-stored") this.addResult(notice.device, notice);
  }
}
