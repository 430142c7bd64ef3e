// @ts-check
/** The numbers of now, large. */

import { firmwareText, holderText, limitText, lookupText, potText, stateClass, STATE_MARK } from "../device-words.js";
import { h, setAttribute, setText } from "../dom.js";
import { duration, fixed, NOTHING, si, words } from "../format.js";
import { heats } from "../telemetry.js";

export class Numbers {
  /**
   * @param {HTMLElement} root
   * @param {import("../context.js").Context} context
   */
  constructor(root, context) {
    this.context = context;
    const big = (/** @type {string} */ testid) => h("span", { class: "live-number", data: { testid } }, NOTHING);
    const cell = (/** @type {string | null} */ testid) => h("dd", testid ? { data: { testid } } : null);
    this.r = big("r-now");
    this.l = big("l-now");
    this.p = big("p-now");
    /** Names: the network gives means over a half-cycle, the device its values at the crest. */
    this.rName = h("dt", null, "R");
    this.lName = h("dt", null, "L");
    this.source = h("p", { class: "quiet live-source", data: { testid: "source" } });
    this.cells = {
      state: cell("state"), fault: cell("fault"), pot: cell("pot"), limit: cell(null), asked: cell(null), frequency: cell(null),
      phase: cell(null), resonance: cell(null), crest: cell(null), lookup: cell("lookup-version"), firmware: cell(null), holder: cell("holder"),
    };
    const labels = { state: "State", fault: "Fault", pot: "Pot", limit: "Power limited by", asked: "Power asked", frequency: "Switching frequency",
      phase: "Phase at the crest", resonance: "Resonance, margin", crest: "I, crest", lookup: "Lookup", firmware: "Firmware", holder: "Commanded by" };
    root.append(h("section", { class: "panel live-numbers", "aria-label": "Now" },
      h("dl", { class: "live-big" },
        h("div", {}, this.rName, h("dd", {}, this.r)),
        h("div", {}, this.lName, h("dd", {}, this.l)),
        h("div", {}, h("dt", {}, "P, mean"), h("dd", {}, this.p))),
      this.source,
      h("dl", { class: "live-rows" }, Object.entries(labels).map(([key, label]) => [h("dt", {}, label), this.cells[/** @type {keyof typeof labels} */ (key)]]))));
    const showAll = () => {
      this.showReport();
      this.showLive();
    };
    this.stops = [
      context.stream.frame("devices", showAll),
      context.stream.frame("telemetry", () => this.showLive()),
      context.stream.on("state", showAll),
    ];
    showAll();
    this.#lastResult();
  }

  /** Ends it. */
  stop() {
    for (const stop of this.stops) stop();
  }

  /** The newest result of the store, so that a reload does not wait for the next one. */
  async #lastResult() {
    const { api, fleet, device } = this.context;
    try {
      const windows = await api.get(api.path(["devices", device, "windows"], { limit: 64 }));
      for (const window of windows.reverse()) fleet.addWindow(device, window);
      const [fit] = await api.get(api.path(["devices", device, "training"], { limit: 1 }));
      if (fit && fit.r_ohm !== null && fit.l_h !== null) fleet.addResult(device, fit);
    } catch {
      // The next result comes by the stream.
    }
  }

  showReport() {
    const { fleet, device, api } = this.context;
    const report = fleet.reports.get(device);
    if (!report) return;
    const { cells } = this;
    setText(cells.state, `${STATE_MARK[report.state] ?? "·"} ${words(report.state)}${report.detail ? `: ${report.detail}` : ""}`);
    setAttribute(cells.state, "data-value", report.state);
    cells.state.className = stateClass(report.state);
    setText(cells.lookup, lookupText(report));
    setAttribute(cells.lookup, "data-value", String(report.lookup.on_device ?? ""));
    setText(cells.firmware, firmwareText(report));
    cells.firmware.className = report.updates_needed ? "bad" : "";
    setText(cells.holder, holderText(report, api.holder()));
    setAttribute(cells.holder, "data-value", report.lease?.holder ?? "");
  }

  showLive() {
    const { fleet, device, hob } = this.context;
    const live = fleet.live(device);
    const telemetry = fleet.telemetry.get(device);
    this.#showNow();
    number(this.p, live ? live.power_w : null, live ? `${fixed(live.power_w, 0)}\u00a0W` : NOTHING);
    const { cells } = this;
    const on = heats(live);
    setText(cells.fault, live?.fault ? `✖ ${live.fault_text} (${live.fault})` : live ? "none" : NOTHING);
    setAttribute(cells.fault, "data-value", live ? String(live.fault) : "");
    cells.fault.className = live?.fault ? "bad" : "";
    setText(cells.pot, live ? `${potText(live.pot)}${live.glass_hot ? "; glass hot" : ""}` : NOTHING);
    setAttribute(cells.pot, "data-value", live?.pot ?? "");
    setText(cells.limit, live ? limitText(live.limit) || "nothing" : NOTHING);
    setText(cells.asked, live ? `${live.asked_w}\u00a0W` : NOTHING);
    setText(cells.frequency, on ? si(live?.f_sw_hz, "Hz", 4) : live ? "off" : NOTHING);
    setText(cells.crest, on ? si(live?.i_crest_a, "A", 3) : NOTHING);
    const phase = on ? telemetry?.phase_deg : null;
    setText(cells.phase, typeof phase === "number" ? `${fixed(phase, 1)}°` : NOTHING);
    const resonance = on ? telemetry?.resonance_hz : null;
    setText(cells.resonance, typeof resonance === "number" && live
      ? `${si(resonance, "Hz", 4)}; f is ${fixed(live.f_sw_hz / resonance, 2)} of it, ${fixed(hob.resonance_margin, 2)} at least`
      : NOTHING);
    cells.resonance.className = typeof resonance === "number" && live && live.f_sw_hz < resonance * hob.resonance_margin * 0.995 ? "warn" : "";
  }

  #showNow() {
    const { fleet, device, stream } = this.context;
    const now = fleet.now(device);
    number(this.r, now.r_ohm, si(now.r_ohm, "Ω", 4));
    number(this.l, now.l_h, si(now.l_h, "H", 4));
    const which = { network: ", mean", device: ", crest", none: "" }[now.source];
    setText(this.rName, `R${which}`);
    setText(this.lName, `L${which}`);
    const age_s = Math.max(0, (stream.daemonNow_ms() - now.at_ms) / 1000);
    const texts = {
      network: `R and L: the network's, means over a half-cycle weighted with i², ${age_s < 1 ? "less than 1\u00a0s" : duration(Math.round(age_s))} old`,
      device: "R and L: the device's own Kalman filter, at the current's crest",
      none: fleet.live(device) ? "R and L are not known while the inverter is off" : "nothing is heard of the device now",
    };
    setText(this.source, texts[now.source]);
    setAttribute(this.source, "data-value", now.source);
    setAttribute(this.source, "data-window", now.window ? `${now.window.boot}/${now.window.seq}` : "");
  }
}

/**
 * A number with its value in SI units beside it.
 * @param {HTMLElement} element
 * @param {number | null} value
 * @param {string} text
 */
function number(element, value, text) {
  setText(element, text);
  setAttribute(element, "data-value", value === null ? "" : String(value));
}
