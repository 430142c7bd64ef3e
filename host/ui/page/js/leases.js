// @ts-check
/** Power that this page asked for: one lease a device, renewed by a worker, given back when the page goes. */

import * as api from "./api.js";
import { noLease, steady_ms, step } from "./lease-machine.js";

/** A report may be so old, in milliseconds: they come every 2 s. */
const QUIET_MS = 3000;

export class Leases {
  /**
   * @param {import("./stream.js").Stream} stream
   * @param {import("./fleet.js").Fleet} fleet
   * @param {number} lease_s how long a lease lasts
   */
  constructor(stream, fleet, lease_s) {
    this.fleet = fleet;
    this.lease_ms = lease_s * 1000;
    /** @type {Map<string, import("./lease-machine.js").LeaseState>} */
    this.states = new Map();
    /** @type {Set<() => void>} */
    this.listeners = new Set();
    /** Requests of each device go one after the other: off comes after the power that was on its way. @type {Map<string, number>} */
    this.turns = new Map();
    /** Until when a report may still be of before the power was asked for. @type {Map<string, number>} */
    this.quietUntil_ms = new Map();
    /** Devices whose power ends by itself. @type {Set<string>} */
    this.sweeping = new Set();
    this.worker = new Worker(new URL("./lease-worker.js", import.meta.url), { type: "module" });
    this.worker.addEventListener("message", (event) => this.#told(event.data));
    this.worker.addEventListener("error", () => this.#workerFailed());
    stream.on("notice", (notice) => this.#notice(notice));
    stream.on("devices", (reports) => reports.forEach((/** @type {any} */ report) => this.#reported(report)));
    addEventListener("pagehide", () => this.releaseAll("the page was left", { keepalive: true }));
    setInterval(() => this.#tick(), 500);
  }

  /**
   * @param {string} device
   * @returns {import("./lease-machine.js").LeaseState}
   */
  state(device) {
    return this.states.get(device) ?? noLease();
  }

  /** @returns {string[]} devices that this page heats, or is about to */
  heated() {
    return [...this.states].filter(([, s]) => s.phase === "held" || s.phase === "late" || s.phase === "taking").map(([name]) => name);
  }

  /**
   * @param {() => void} listener called after every change
   * @returns {() => void} ends it
   */
  on(listener) {
    this.listeners.add(listener);
    return () => {
      this.listeners.delete(listener);
    };
  }

  /**
   * Takes the lease and carries out a command under it, which heats: power or a sweep.
   * @param {string} device
   * @param {{command: string, [field: string]: any}} body
   * @param {boolean} [force] takes it from whoever has it
   * @returns {Promise<{text: string, granted_w: number | null}>}
   */
  async heat(device, body, force = false) {
    const power_w = body.power_w ?? Math.max(...(body.powers_w ?? [0]));
    const turn = this.#turn(device);
    this.#step(device, { type: "take", power_w, at_ms: steady_ms() });
    try {
      await api.takeLease(device, force);
      if (this.turns.get(device) !== turn) throw new api.ApiError(0, { error: "overtaken", message: "it was switched off, or set anew, meanwhile" });
      this.#hold(device);
      const asked_ms = steady_ms();
      const done = await api.command(device, body).finally(() => {
        if (this.turns.get(device) !== turn && !this.heated().includes(device)) this.overtaken(device);
      });
      if (this.turns.get(device) === turn) {
        this.#step(device, { type: "powered", power_w: done.granted_w ?? power_w, asked_w: power_w, at_ms: asked_ms });
        this.quietUntil_ms.set(device, steady_ms() + QUIET_MS);
        if (body.command === "sweep") this.sweeping.add(device);
        else this.sweeping.delete(device);
      }
      return done;
    } catch (why) {
      // The lease is that of the command which came after.
      if (this.turns.get(device) !== turn && this.heated().includes(device)) throw why;
      this.#step(device, { type: "refused", why: String(/** @type {any} */ (why)?.message ?? why) });
      if (this.state(device).phase === "none") {
        this.#drop(device);
        if (!(why instanceof api.ApiError && why.status === 423)) api.releaseLease(device).catch(() => {});
      }
      throw why;
    }
  }

  /**
   * A command that needs the lease but does not heat: one that is free is taken by the command itself.
   * @param {string} device
   * @param {{command: string, [field: string]: any}} body
   * @param {boolean} [force] takes the lease from whoever has it, which switches his power off
   * @returns {Promise<{text: string, file: string | null}>}
   */
  async act(device, body, force = false) {
    if (!force) return api.command(device, body);
    await api.takeLease(device, true);
    try {
      return await api.command(device, body);
    } finally {
      if (!this.heated().includes(device)) await api.releaseLease(device).catch(() => {});
    }
  }

  /**
   * This page does not heat it any more: nothing is renewed from here on. Switching off is {@link import("./off.js")}'s.
   * @param {string} device
   */
  forget(device) {
    this.#turn(device);
    this.#drop(device);
    this.#step(device, { type: "off" });
  }

  /**
   * A person has read why it was lost.
   * @param {string} device
   */
  seen(device) {
    this.#step(device, { type: "seen" });
  }

  /**
   * Power was asked for, and Off pressed before the answer came: whichever the daemon heard last counts, so Off is said
   * again. Another power that was set meanwhile begins with the same lease, and is not touched.
   * @type {(device: string) => void}
   */
  overtaken = () => {};

  /** @param {string} device */
  #turn(device) {
    const turn = (this.turns.get(device) ?? 0) + 1;
    this.turns.set(device, turn);
    return turn;
  }

  /** @param {string} device */
  #hold(device) {
    const url = api.address(api.path(["devices", device, "lease"]));
    this.worker.postMessage({ type: "hold", device, url, holder: api.holder() });
  }

  /** @param {string} device */
  #drop(device) {
    this.worker.postMessage({ type: "drop", device });
  }

  /**
   * @param {string} device
   * @param {import("./lease-machine.js").LeaseEvent} event
   */
  #step(device, event) {
    const before = this.state(device);
    const after = step(before, event);
    if (after === before) return;
    this.states.set(device, after);
    if (after.phase === "lost" && before.phase !== "lost") {
      this.#turn(device);
      this.#drop(device);
    }
    for (const listener of this.listeners) listener();
  }

  /** @param {any} told */
  #told(told) {
    if (told.type === "ping") {
      this.worker.postMessage({ type: "pong" });
    } else if (told.type === "given-back") {
      this.#step(told.device, { type: "ended", why: "this page did not answer for 4 s, so its power was given up" });
    } else if (!this.heated().includes(told.device)) {
      this.#drop(told.device);
    } else if (told.ok) {
      this.#step(told.device, { type: "renewed", at_ms: told.asked_ms });
    } else if (told.status === 423) {
      this.#step(told.device, { type: "taken", by: told.answer.holder ?? "somebody" });
    }
  }

  /** @param {any} notice */
  #notice(notice) {
    if (notice.event === "lease" && notice.taken_from === api.holder()) {
      this.#step(notice.device, { type: "taken", by: notice.holder || "somebody" });
    }
    if (notice.event === "lease" && !notice.holder && notice.why) this.#ended(notice.device, notice.why);
    if (notice.event === "command" && notice.ok && notice.holder !== api.holder() && /^off\b/.test(notice.text)) {
      this.#ended(notice.device, `${notice.holder} switched it off`);
    }
  }

  /**
   * The daemon's own word: it may have been started anew, or somebody switched off.
   * @param {any} report
   */
  #reported(report) {
    const held = this.state(report.name).phase === "held";
    if (!held || steady_ms() < (this.quietUntil_ms.get(report.name) ?? 0)) return;
    if (report.asked_by_daemon_w === 0 && report.sweep_left_w.length === 0) {
      if (this.sweeping.has(report.name)) this.#sweepDone(report.name);
      else this.#ended(report.name, "the daemon asks for no power any more: it was switched off, or the daemon was started anew");
    } else if (report.lease && report.lease.holder !== api.holder()) {
      this.#step(report.name, { type: "taken", by: report.lease.holder });
    } else if (!this.sweeping.has(report.name)) {
      this.#step(report.name, { type: "reported", power_w: report.asked_by_daemon_w });
    }
  }

  /**
   * @param {string} device
   * @param {string} why
   */
  #ended(device, why) {
    if (!this.heated().includes(device)) return;
    this.#step(device, { type: "ended", why });
    api.releaseLease(device).catch(() => {});
  }

  /** @param {string} device */
  #sweepDone(device) {
    this.sweeping.delete(device);
    this.#turn(device);
    this.#drop(device);
    this.#step(device, { type: "done", why: "the sweep is done, and the hob is off" });
    api.releaseLease(device).catch(() => {});
  }

  #tick() {
    for (const device of this.heated()) {
      this.#step(device, { type: "tick", at_ms: steady_ms(), lease_ms: this.lease_ms });
      if (this.state(device).phase === "lost") api.releaseLease(device).catch(() => {});
    }
  }

  #workerFailed() {
    for (const device of this.heated()) {
      this.#step(device, { type: "ended", why: "the worker that renews failed; reload the page" });
      api.releaseLease(device).catch(() => {});
    }
  }

  /**
   * What this page heats goes off at once: it is left or put aside, or its session ends.
   * @param {string} why
   * @param {import("./api.js").RequestOptions} options
   */
  async releaseAll(why, options) {
    await Promise.all(this.heated().map((device) => {
      if (this.state(device).phase === "taking") this.forget(device);
      this.#step(device, { type: "ended", why });
      return api.releaseLease(device, options).catch(() => {});
    }));
  }
}
