// @ts-check
/**
 * Off. Needs no lease, and goes on trying, loudly, until it was acknowledged or the daemon says that the hob is off, or has no link to it.
 */

import * as api from "./api.js";
import { h, setText } from "./dom.js";
import { duration } from "./format.js";

/** One try's time, in milliseconds. */
const TRY_MS = 2500;
const FIRST_WAIT_MS = 250;
const MAX_WAIT_MS = 2000;

/** Time after which a hob that the daemon cannot reach is given up: it has ended its power by itself. */
const AWAY_MS = 15000;

/** How long success stays to be read. */
const DONE_MS = 4000;

export class Off {
  /**
   * @param {{fleet: import("./fleet.js").Fleet, stream: import("./stream.js").Stream,
   *   leases: import("./leases.js").Leases, alarms: HTMLElement, announce: (text: string) => void, logIn: () => void}} parts `logIn` asks for a token
   */
  constructor(parts) {
    this.parts = parts;
    /** Devices that are being switched off. @type {Map<string, {tries: number, began_ms: number, seenOff: boolean}>} */
    this.under = new Map();
    parts.stream.on("devices", (reports) => reports.forEach((/** @type {any} */ report) => this.#reported(report)));
  }

  /**
   * Switches off the chosen device and whatever else this page heats.
   * @param {string} chosen its name; empty for none
   */
  press(chosen) {
    const targets = new Set(this.parts.leases.heated());
    if (chosen) targets.add(chosen);
    for (const device of targets) this.#begin(device);
  }

  /**
   * Switches off one device.
   * @param {string} device
   */
  only(device) {
    this.#begin(device);
  }

  /** @param {string} device */
  #begin(device) {
    this.parts.leases.forget(device);
    if (this.under.has(device)) return;
    const work = { tries: 0, began_ms: performance.now(), seenOff: false };
    this.under.set(device, work);
    const count = h("span", { class: "alarm-count", "aria-hidden": "true" });
    const why = h("span", { class: "alarm-why" });
    const row = h("div", { class: "alarm off-alarm" }, h("strong", {}, `Switching off ${device}`), " ", why, " ", count);
    this.parts.alarms.append(row);
    this.#try(device, work, row, why, count);
  }

  /**
   * @param {string} device
   * @param {{tries: number, began_ms: number, seenOff: boolean}} work
   * @param {HTMLElement} row
   * @param {HTMLElement} why
   * @param {HTMLElement} count
   */
  async #try(device, work, row, why, count) {
    for (;;) {
      work.tries += 1;
      try {
        await api.command(device, { command: "off" }, { timeoutMs: TRY_MS });
        this.#done(device, row, `${device} is off`);
        return;
      } catch (error) {
        const problem = /** @type {import("./api.js").ApiError} */ (error);
        if (work.seenOff) {
          this.#done(device, row, `${device} is off, says the daemon`);
          return;
        }
        if (problem.status === 403 || problem.status === 404) {
          this.#failed(device, row, problem.message);
          return;
        }
        if (problem.error === "not-connected" && performance.now() - work.began_ms > AWAY_MS) {
          this.#failed(device, row, `${problem.message}; a hob that hears no host ends what a host asked for within 10 s`);
          return;
        }
        if (problem.status === 401) {
          this.parts.logIn();
          setText(why, "— the session has ended: log in again, or use the hob's own switch.");
        } else setText(why, `— not acknowledged: ${problem.message}. The hob goes off by itself 10 s after it last heard of the host; if it does not, use its own switch.`);
        setText(count, `Try ${work.tries}, for ${duration((performance.now() - work.began_ms) / 1000)}.`);
      }
      await new Promise((wake) => setTimeout(wake, Math.min(MAX_WAIT_MS, FIRST_WAIT_MS * 1.5 ** work.tries)));
    }
  }

  /**
   * @param {string} device
   * @param {HTMLElement} row
   * @param {string} text
   */
  #done(device, row, text) {
    this.under.delete(device);
    row.classList.add("done");
    row.replaceChildren(h("strong", {}, text));
    this.parts.announce(text);
    api.releaseLease(device).catch(() => {});
    setTimeout(() => row.remove(), DONE_MS);
  }

  /**
   * @param {string} device
   * @param {HTMLElement} row
   * @param {string} why
   */
  #failed(device, row, why) {
    this.under.delete(device);
    row.replaceChildren(
      h("strong", {}, `${device} was not switched off: ${why}.`), " Use the hob's own switch. ",
      h("button", { type: "button", class: "small", on: { click: () => row.remove() } }, "I have read it"));
  }

  /**
   * Whether the daemon says that it is off, in a report of after the press.
   * @param {any} report
   */
  #reported(report) {
    const work = this.under.get(report.name);
    if (!work || performance.now() - work.began_ms < 500) return;
    const live = report.live;
    work.seenOff = report.asked_by_daemon_w === 0 && report.state !== "searching" && report.state !== "suspended"
      && !!live && live.asked_w === 0 && live.f_sw_hz === 0;
  }
}
