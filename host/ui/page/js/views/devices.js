// @ts-check
/** Every device: what it does, and whether it is well. One card each, from 1 to 32. */

import { h, setAttribute, setText } from "../dom.js";
import { firstRun } from "../first-run.js";
import { duration, fixed, NOTHING, si, watt, words } from "../format.js";
import { hashOf } from "../router.js";
import { firmwareText, holderText, lookupText, potText, stateClass, STATE_MARK } from "../device-words.js";

/**
 * @param {HTMLElement} root
 * @param {import("../context.js").Context} context
 * @returns {{unmount: () => void}}
 */
export function mount(root, context) {
  const { fleet, stream } = context;
  const summary = h("p", { class: "quiet devices-summary" });
  const list = h("ul", { class: "devices" });
  const begin = firstRun(context);
  root.append(h("h1", {}, "Devices"), summary, begin, list);
  /** @type {Map<string, Card>} */
  const cards = new Map();

  const showReports = () => {
    for (const [name, card] of cards) {
      if (fleet.reports.has(name)) continue;
      card.root.remove();
      cards.delete(name);
    }
    for (const report of fleet.reports.values()) {
      let card = cards.get(report.name);
      if (!card) {
        card = new Card(report, context);
        cards.set(report.name, card);
        list.append(card.root);
      }
      card.show(report);
    }
    begin.hidden = fleet.reports.size > 0;
    setText(summary, summaryText([...fleet.reports.values()]));
  };
  const showLive = () => {
    for (const [name, card] of cards) card.showLive(fleet, name);
  };
  showReports();
  showLive();
  const stops = [
    stream.frame("devices", showReports),
    stream.frame("telemetry", showLive),
    stream.on("state", showLive),
    context.leases.on(showReports),
  ];
  return { unmount: () => stops.forEach((stop) => stop()) };
}

/** @param {any[]} reports */
function summaryText(reports) {
  if (reports.length === 0) {
    return "No device is there yet.";
  }
  const count = (/** @type {string[]} */ states) => reports.filter((report) => states.includes(report.state)).length;
  const parts = [`${reports.length} ${reports.length === 1 ? "device" : "devices"}`];
  for (const [states, text] of /** @type {[string[], string][]} */ ([
    [["learning"], "heating"], [["faulted"], "with a fault"], [["waiting-for-pot"], "waiting for a pot"],
    [["searching", "suspended", "incompatible"], "not usable now"],
  ])) {
    if (count(states)) parts.push(`${count(states)} ${text}`);
  }
  return parts.join(" · ");
}

/** Rows of a card: key and label. */
const ROWS = /** @type {const} */ ([
  ["power", "Power asked, delivered"], ["load", "R, L"], ["pot", "Pot"], ["fault", "Fault"], ["firmware", "Firmware"],
  ["lookup", "Lookup"], ["windows", "Windows"], ["holder", "Commanded by"], ["seen", "Last seen"],
]);

class Card {
  /**
   * @param {any} report
   * @param {import("../context.js").Context} context
   */
  constructor(report, context) {
    this.context = context;
    /** @type {Record<string, HTMLElement>} */
    this.cells = {};
    this.state = h("span", { class: "state" });
    this.detail = h("p", { class: "detail quiet" });
    const rows = ROWS.map(([key, label]) => {
      this.cells[key] = h("dd", { class: `cell-${key}` });
      return [h("dt", {}, label), this.cells[key]];
    });
    const off = h("button", { type: "button", class: "small danger", "aria-label": `Switch ${report.name} off`, on: { click: () => context.off.only(report.name) } }, "Off");
    this.root = h("li", { class: "device panel", data: { testid: `device-${report.serial || report.name}` } },
      h("div", { class: "device-head" },
        h("h2", {}, h("a", { href: hashOf("live", report.name) }, report.name)), this.state, off),
      this.detail,
      h("dl", {}, rows));
  }

  /** @param {any} report */
  show(report) {
    const { cells } = this;
    setText(this.state, `${STATE_MARK[report.state] ?? "·"} ${words(report.state)}`);
    this.state.className = `state ${stateClass(report.state)}`;
    setAttribute(this.root, "data-state", report.state);
    const sweep = report.sweep_left_w.length ? ` Sweep: ${report.sweep_left_w.map((/** @type {number} */ w) => fixed(w)).join(", ")} W to come.` : "";
    const flood = report.frames_beyond ? ` It has sent ${report.frames_beyond} frames more than a hob does: dropped.` : "";
    setText(this.detail, `${report.detail}${sweep}${flood}${report.recording ? ` Recording ${report.recording}.` : ""}`);
    setText(cells.firmware, firmwareText(report));
    cells.firmware.className = report.updates_needed ? "cell-firmware bad" : "cell-firmware";
    setText(cells.lookup, lookupText(report));
    const w = report.windows;
    const lost = w.dropped_by_device + w.lost + w.refused + w.not_stored;
    setText(cells.windows, `${w.stored} stored, ${w.learned} learned${lost ? `, ${lost} lost or refused` : ""}`);
    setText(cells.holder, holderText(report, this.context.api.holder()));
    this.report = report;
  }

  /**
   * @param {import("../fleet.js").Fleet} fleet
   * @param {string} name
   */
  showLive(fleet, name) {
    const { cells } = this;
    const live = fleet.live(name);
    setText(cells.power, live ? `${watt(live.asked_w)}, ${watt(live.power_w)}` : NOTHING);
    const now = fleet.now(name);
    setText(cells.load, now.source === "none" ? NOTHING : `${si(now.r_ohm, "Ω", 4)}, ${si(now.l_h, "H", 4)} (${now.source})`);
    setText(cells.pot, live ? potText(live.pot) : NOTHING);
    const fault = live?.fault ? `✖ ${live.fault_text} (${live.fault})` : "none";
    setText(cells.fault, live ? fault : NOTHING);
    cells.fault.className = live?.fault ? "cell-fault bad" : "cell-fault";
    const heard = fleet.heard_ms.get(name);
    const silent = heard === undefined ? null : (performance.now() - heard) / 1000;
    const gone = this.report.state === "searching" ? `not for ${duration(this.report.since_s)}` : NOTHING;
    setText(cells.seen, silent === null ? gone : silent < 2 ? "now" : `${duration(Math.round(silent))} ago`);
  }
}
