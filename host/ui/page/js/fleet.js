// @ts-check
/** What is known of each device now: newest report, newest telemetry, newest result of the network. */

import { heats } from "./telemetry.js";

/** How long a result of the network stands for now, in milliseconds. */
export const RESULT_LASTS_MS = 10_000;

/** States in which the last half-cycle is none of now. */
const SILENT = new Set(["searching", "suspended", "incompatible"]);

/**
 * @typedef {{at_ms: number, boot: number, seq: number, f_sw_hz: number, r_ohm: number, l_h: number, pass: boolean,
 *   why: string}} Result
 * @typedef {{r_ohm: number | null, l_h: number | null, source: "network" | "device" | "none", at_ms: number}} Now
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
    /** @type {Map<string, Result>} newest result that the gate let pass */
    this.results = new Map();
    stream.on("devices", (reports) => this.setReports(reports));
    stream.on("telemetry", (event) => {
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
    for (const map of [this.telemetry, this.heard_ms, this.results]) {
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
   * A result that was read from the store when the page was loaded.
   * @param {string} name
   * @param {Result} result
   */
  addResult(name, result) {
    const known = this.results.get(name);
    if (result.pass && (!known || known.at_ms < result.at_ms)) this.results.set(name, result);
  }

  /**
   * R and L now: the network's last result that passed within 10 s, else the device's own.
   * @param {string} name
   * @returns {Now}
   */
  now(name) {
    const live = this.live(name);
    if (!heats(live)) return { r_ohm: null, l_h: null, source: "none", at_ms: 0 };
    const result = this.results.get(name);
    if (result && this.stream.daemonNow_ms() - result.at_ms < RESULT_LASTS_MS) {
      return { r_ohm: result.r_ohm, l_h: result.l_h, source: "network", at_ms: result.at_ms };
    }
    const own = /** @type {import("./telemetry.js").Live} */ (live);
    return { r_ohm: own.r_ohm, l_h: own.l_h, source: "device", at_ms: this.stream.lastAt_ms };
  }

  /** @param {any} notice */
  #notice(notice) {
    if (notice.event === "result-stored") this.addResult(notice.device, notice);
  }
}
