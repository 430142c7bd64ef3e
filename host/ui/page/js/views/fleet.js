// @ts-check
/** The fleet that the daemon is an edge of: what waits, who identifies, and every hob of every edge. */

import { append, h, setAttribute, setText } from "../dom.js";
import { csv, downloadCsv, fileName } from "../export.js";
import { fixed, isoUtc } from "../format.js";
import { DEVICES, EDGES, WORKERS } from "../fleet-report/columns.js";
import { ageText, devicesText, filtered, protocolText, serverText } from "../fleet-report/rows.js";
import { RowTable } from "../fleet-report/table.js";
import { Newest } from "../newest.js";

/** Between two readings, in milliseconds: an edge learns of the fleet that often. */
const AGAIN_MS = 2000;
/** Words that count on, in milliseconds. */
const TICK_MS = 1000;
/** After the last key in the filter, in milliseconds. */
const TYPED_MS = 120;

/** Tiles: key of the report, label, what it is. */
const TILES = /** @type {const} */ ([
  ["windows", "Windows", "that the fleet has acknowledged, ever"],
  ["results", "Results", "each of another window"],
  ["backlog", "Backlog", "windows that nobody has identified yet"],
  ["dead", "Dead", "windows that were given up: ihd-fleet status dead"],
  ["outbox", "Outbox", "of this edge, not acknowledged yet"],
  ["workers", "Workers", ""],
]);

/** Windows of this edge by their progress: key of the report's states, label, what it is. Together all that its store has. */
const STATES = /** @type {const} */ ([
  ["due", "Due", "the fleet has neither them nor their results"],
  ["sent", "Sent", "the fleet owes their results"],
  ["answered", "Answered", "by the fleet"],
  ["learned_here", "Learned here", "and the fleet knows"],
  ["no_samples", "Not sent", "given up: their samples went before"],
  ["dead", "Given up", "no worker could identify them"],
  ["not_for_fleet", "Not for the fleet", "without samples, not heating, or of before"],
]);

/** @typedef {import("../context.js").Context} Context */
/** @typedef {import("../fleet-report/rows.js").Report} Report */

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
  const view = new FleetView(root, context);
  return { unmount: () => view.unmount() };
}

class FleetView {
  /** @param {HTMLElement} root @param {Context} context */
  constructor(root, context) {
    this.context = context;
    /** @type {Report | null} */
    this.report = null;
    this.timer = 0;
    this.typing = 0;
    this.stop = new AbortController();
    this.reads = new Newest(() => this.read(), (why) => this.failed(why));
    const now_ms = () => context.stream.daemonNow_ms();
    this.now_ms = now_ms;
    this.workers = new RowTable({ name: "workers", label: "Workers", columns: WORKERS, sort: "name", now_ms });
    this.edges = new RowTable({ name: "edges", label: "Edges", columns: EDGES, sort: "name", now_ms });
    this.devices = new RowTable({ name: "devices", label: "Devices of all edges", columns: DEVICES, sort: "name", now_ms });
    this.build(root);
    this.ticking = setInterval(() => this.tick(), TICK_MS);
    this.visible = () => !document.hidden && this.load();
    document.addEventListener("visibilitychange", this.visible);
    this.load();
  }

  unmount() {
    this.reads.stop();
    this.stop.abort();
    clearTimeout(this.timer);
    clearTimeout(this.typing);
    clearInterval(this.ticking);
    document.removeEventListener("visibilitychange", this.visible);
    for (const table of [this.workers, this.edges, this.devices]) table.stop();
  }

  /** @param {HTMLElement} root */
  build(root) {
    this.state = h("p", { class: "fleet-state quiet", role: "status" }, "Reading what is known of the fleet …");
    this.server = h("span", { data: { testid: "fleet-server" } });
    this.age = h("span", { class: "quiet", data: { testid: "fleet-age" } });
    this.edge = h("span", { class: "quiet" });
    this.tiles = Object.fromEntries(TILES.map(([key]) => [key, h("dd", { data: { testid: `fleet-${key === "workers" ? "worker-count" : key}` } })]));
    this.busy = h("dd", { class: "fleet-what quiet" });
    const tiles = TILES.map(([key, label, what]) => h("div", { class: "fleet-tile" }, h("dt", null, label), this.tiles[key], key === "workers" ? this.busy : h("dd", { class: "fleet-what quiet" }, what)));
    this.states = Object.fromEntries(STATES.map(([key]) => [key, h("dd", { data: { testid: `fleet-state-${key}` } })]));
    const states = STATES.map(([key, label, what]) => h("div", { class: "fleet-tile" }, h("dt", null, label), this.states[key], h("dd", { class: "fleet-what quiet" }, what)));
    this.alarms = h("ul", { class: "fleet-alarms", hidden: true, role: "alert", data: { testid: "fleet-alarms" } });
    this.count = h("p", { class: "fleet-count", data: { testid: "fleet-count" } });
    this.none = h("p", { class: "quiet" });
    this.content = h("div", { class: "fleet-content", hidden: true },
      h("p", { class: "fleet-head" }, this.server, " ", this.edge, " ", this.age),
      this.alarms,
      h("dl", { class: "fleet-tiles" }, tiles),
      h("section", null, h("h2", null, "Windows of this edge"), h("dl", { class: "fleet-tiles" }, states)),
      h("section", null, h("h2", null, "Devices"), this.#tools(), this.count, this.devices.element, this.none),
      h("div", { class: "fleet-columns" },
        h("section", null, h("h2", null, "Workers"), this.workers.element),
        h("section", null, h("h2", null, "Edges"), this.edges.element)));
    append(root, [h("h1", null, "Fleet"), this.state, this.content]);
  }

  #tools() {
    const changed = { change: () => this.chosen() };
    this.text = h("input", { type: "search", placeholder: "name, edge, state, pot, firmware", autocomplete: "off", spellcheck: "false", data: { testid: "fleet-filter" }, on: { input: () => this.typed() } });
    this.outdated = h("input", { type: "checkbox", data: { testid: "fleet-outdated" }, on: changed });
    this.silent = h("input", { type: "checkbox", data: { testid: "fleet-silent" }, on: changed });
    const save = h("button", { type: "button", "aria-label": "Save the devices that are seen as CSV", on: { click: () => this.save() } }, "CSV");
    return h("div", { class: "fleet-tools", role: "search" },
      h("label", { class: "fleet-text" }, h("span", null, "Text"), this.text),
      h("label", { class: "fleet-switch" }, this.outdated, "outdated only"),
      h("label", { class: "fleet-switch" }, this.silent, "silent for 30 s only"),
      save);
  }

  /** Reads it now, and from then on again and again. */
  load() {
    clearTimeout(this.timer);
    this.reads.ask(undefined);
  }

  again() {
    clearTimeout(this.timer);
    // A hidden page asks for nothing; it reads at once when it is seen.
    if (!document.hidden && !this.stop.signal.aborted) this.timer = setTimeout(() => this.load(), AGAIN_MS);
  }

  async read() {
    const { api } = this.context;
    const options = { signal: this.stop.signal };
    // Who is no edge says so in the session: a 404 each time would be an error in the browser's log.
    const { fleet } = this.report ? { fleet: true } : await api.get("session", options);
    const report = fleet ? await api.get("fleet", options) : null;
    if (this.stop.signal.aborted) return;
    this.again();
    if (!report) return this.noFleet();
    this.report = report;
    this.context.foundFleet();
    this.show();
  }

  noFleet() {
    this.content.hidden = true;
    this.state.hidden = false;
    setText(this.state, "This daemon belongs to no fleet: [fleet] url in ihd.toml makes it an edge (docs/fleet.md).");
  }

  /** @param {unknown} why */
  failed(why) {
    // The daemon may have come back as no edge of any.
    if (why instanceof this.context.api.ApiError && why.status === 404) {
      this.report = null;
      this.noFleet();
    } else {
      this.state.hidden = false;
      setText(this.state, `The fleet cannot be read: ${why instanceof Error ? why.message : why}. Trying again …`);
    }
    this.again();
  }

  show() {
    const report = this.report;
    if (!report) return;
    this.state.hidden = true;
    this.content.hidden = false;
    for (const [key] of TILES) {
      const value = key === "workers" ? report.workers.length : report[key];
      // 0: the fleet was never read; the outbox is this edge's own.
      setText(this.tiles[key], report.at_ms > 0 || key === "outbox" ? fixed(value) : "–");
      setAttribute(this.tiles[key], "data-value", String(value));
      setAttribute(this.tiles[key], "class", key === "dead" && value > 0 ? "bad" : null);
    }
    for (const [key] of STATES) {
      setText(this.states[key], fixed(report.states[key]));
      setAttribute(this.states[key], "data-value", String(report.states[key]));
    }
    this.showAlarms(report.alarms);
    setText(this.busy, busyText(report));
    setText(this.edge, report.edge ? `as the edge ${report.edge};` : "");
    this.workers.show(report.workers);
    this.edges.show(report.edges);
    this.showDevices();
    this.showHead();
  }

  /** @param {string[]} alarms what needs somebody; a text that stays is not said aloud again */
  showAlarms(alarms) {
    const there = Array.from(this.alarms.children, (line) => line.textContent);
    if (there.join("\n") === alarms.join("\n")) return;
    this.alarms.replaceChildren(...alarms.map((text) => h("li", null, text)));
    this.alarms.hidden = alarms.length === 0;
  }

  showHead() {
    const report = this.report;
    if (!report) return;
    setText(this.server, `${serverText(report)}${report.edge ? "" : ";"}`);
    setAttribute(this.server, "data-value", String(report.connected));
    this.server.className = report.connected ? "good" : "bad";
    setText(this.age, `${ageText(report, this.now_ms())}.`);
  }

  /** @returns {import("../fleet-report/rows.js").Filter} */
  filter() {
    return { text: this.text.value, outdated: this.outdated.checked, silent: this.silent.checked };
  }

  showDevices() {
    const all = this.report?.devices ?? [];
    const seen = filtered(all, this.filter(), this.now_ms());
    this.devices.show(seen);
    setText(this.count, devicesText(all, seen.length, this.now_ms()));
    setAttribute(this.count, "data-value", String(seen.length));
    this.none.hidden = seen.length > 0 || all.length === 0;
    setText(this.none, "No device is of this kind.");
  }

  typed() {
    clearTimeout(this.typing);
    this.typing = setTimeout(() => this.chosen(), TYPED_MS);
  }

  /** Another choice of devices, which is said aloud. */
  chosen() {
    this.showDevices();
    this.devices.element.scrollTop = 0;
    this.context.announce(this.count.textContent ?? "");
  }

  /** Ages count on between two readings, and without any. */
  tick() {
    if (document.hidden || !this.report) return;
    this.showHead();
    // Who has become silent meanwhile changes what is chosen.
    if (this.silent.checked) this.showDevices();
    else this.devices.draw();
    setText(this.count, devicesText(this.report.devices, this.devices.rows.length, this.now_ms()));
    this.workers.draw();
    this.edges.draw();
  }

  save() {
    const now_ms = Date.now();
    const { text, outdated, silent } = this.filter();
    const kind = [text && `text ${text}`, outdated && "outdated only", silent && "silent only"].filter(Boolean).join(", ") || "not filtered";
    const rows = this.devices.rows.map((d) => [
      d.name, d.edge, d.state, d.pot, d.build, d.outdated, protocolText(d.protocol), d.lookup_version, d.last_seen_ms > 0 ? isoUtc(d.last_seen_ms) : "",
    ]);
    const head = ["device", "edge", "state", "pot", "firmware", "outdated", "protocol", "lookup_version", "last_seen_utc"];
    downloadCsv(fileName(["fleet", "devices"], now_ms, "csv"), csv([`devices of the fleet of ${this.report?.server ?? ""}; ${kind}`, `saved ${isoUtc(now_ms)}`], head, rows));
  }
}

/** @param {Report} report */
function busyText({ workers }) {
  if (workers.length === 0) return "nobody identifies: ihd-fleet worker";
  const sum = (/** @type {"busy" | "threads"} */ key) => workers.reduce((total, worker) => total + worker[key], 0);
  return `${sum("busy")} of ${sum("threads")} threads busy`;
}
