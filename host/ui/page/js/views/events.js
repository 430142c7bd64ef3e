// @ts-check
/** What happened: the journal of the store with live notices before it; filters, older pages, CSV. */

import { fill } from "../choice.js";
import { append, h, setText } from "../dom.js";
import { csv, downloadCsv, fileName } from "../export.js";
import { dateTime, isoUtc } from "../format.js";
import { fromNotice, isAlarm, matches, MAX_OF_PAGE, older, withNewest, withOlder } from "../journal.js";
import { Newest } from "../newest.js";

/** Entries of a page. */
const PAGE = 200;

/** Most entries that are kept; beyond, a filter of time leads further back. */
const MOST = 5000;

/** The journal is read again so long after a notice, in milliseconds: what belongs together comes together. */
const AGAIN_MS = 700;

/** A notice may stand alone for so long before its entry is in the journal, in milliseconds. */
const LATE_MS = 5000;

/** Kinds of the store and of the event stream, for the filter; those that were seen are added. */
const KINDS = ["fault", "command", "state", "pot", "off", "sweep", "lookup", "lease", "recording", "window", "learned", "store", "damage"];

/** @typedef {import("../context.js").Context} Context */
/** @typedef {import("../journal.js").Entry} Entry */

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
  const view = new EventsView(root, context);
  return { unmount: () => view.unmount() };
}

class EventsView {
  /** @param {HTMLElement} root @param {Context} context */
  constructor(root, context) {
    this.context = context;
    /** @type {Set<string>} kinds that can be chosen */
    this.kinds = new Set(KINDS);
    /** @type {Entry[]} newest first */
    this.entries = [];
    this.ended = false;
    /** @type {Set<"fresh" | "newest" | "older">} what is to be read */
    this.wishes = new Set();
    this.timer = 0;
    /** @type {WeakMap<Entry, HTMLElement>} */
    this.rows = new WeakMap();
    this.stop = new AbortController();
    this.reads = new Newest(() => this.work(), (why) => this.failed(why));
    this.build(root);
    const { stream } = context;
    this.ends = [
      stream.frame("notice", (notices) => this.noticed(notices)),
      stream.frame("missed", () => this.loadSoon()),
      stream.on("gap", () => this.loadSoon()),
    ];
    this.load();
  }

  unmount() {
    this.reads.stop();
    this.stop.abort();
    clearTimeout(this.timer);
    clearTimeout(this.typing);
    for (const end of this.ends) end();
  }

  /** @param {HTMLElement} root */
  build(root) {
    const label = (/** @type {string} */ name, /** @type {Node} */ control, kind = "") => h("label", { class: `events-choice ${kind}` }, h("span", null, name), control);
    const reload = { change: () => this.load() };
    this.device = h("select", { on: reload }, h("option", { value: "*" }, "all"), h("option", { value: "" }, "the daemon itself"));
    this.kind = h("select", { on: reload }, h("option", { value: "" }, "all"));
    this.text = h("input", { type: "search", placeholder: "words", autocomplete: "off", on: { input: () => this.typed() } });
    this.since = h("input", { type: "datetime-local", step: "1", on: reload });
    this.before = h("input", { type: "datetime-local", step: "1", on: reload });
    const clear = h("button", { type: "button", on: { click: () => this.clear() } }, "Clear");
    const save = h("button", { type: "button", "aria-label": "Save what is seen as CSV", on: { click: () => this.save() } }, "CSV");
    this.state = h("p", { class: "events-state quiet", role: "status" }, "Reading the journal …");
    this.body = h("tbody", null);
    const head = ["Time", "Device", "Kind", "Who", "What"];
    const table = h(
      "table",
      { class: "events-table", data: { testid: "events" } },
      h("caption", { class: "unseen" }, "What happened, newest first"),
      h("thead", null, h("tr", null, head.map((text) => h("th", { scope: "col" }, text)))),
      this.body,
    );
    this.more = h("button", { type: "button", hidden: true, on: { click: () => this.loadOlder() } }, "Load older");
    this.end = h("p", { class: "quiet" });
    append(root, [
      h("h1", null, "Events"),
      h(
        "div",
        { class: "events-tools", role: "search" },
        label("Device", this.device),
        label("Kind", this.kind),
        label("Text", this.text, "events-text"),
        label("From", this.since),
        label("To", this.before),
        h("span", { class: "events-buttons" }, clear, save),
      ),
      this.state,
      h("div", { class: "events-scroll", tabindex: "0", role: "region", "aria-label": "Events" }, table),
      h("div", { class: "events-end" }, this.more, this.end),
    ]);
    this.fillChoices();
  }

  fillChoices() {
    const wanted = { device: this.device.value, kind: this.kind.value };
    const names = [...new Set([...this.context.fleet.names(), ...this.entries.map((entry) => entry.device)])].filter(Boolean);
    for (const entry of this.entries) this.kinds.add(entry.kind);
    fill(this.device, [["*", "all"], ["", "the daemon itself"], ...names.map((name) => /** @type {[string, string]} */ ([name, name]))]);
    fill(this.kind, [["", "all"], ...[...this.kinds].map((kind) => /** @type {[string, string]} */ ([kind, kind]))]);
    this.device.value = wanted.device;
    this.kind.value = wanted.kind;
  }

  /** @returns {import("../journal.js").Filter} */
  filter() {
    const at = (/** @type {HTMLInputElement} */ input) => (input.value ? new Date(input.value).getTime() : null);
    return {
      device: this.device.value === "*" ? null : this.device.value,
      kind: this.kind.value,
      text: this.text.value,
      since_ms: at(this.since),
      before_ms: at(this.before),
    };
  }

  /** The journal, as the daemon filters it; the rest is filtered here. @param {{before: number | null, limit: number}} end */
  read(end) {
    const { api } = this.context;
    const filter = this.filter();
    const before = [filter.before_ms, end.before].filter((ms) => ms !== null).map(Number);
    const query = {
      device: filter.device,
      kind: filter.kind || null,
      since: filter.since_ms,
      before: before.length ? Math.min(...before) : null,
      limit: end.limit,
    };
    return /** @type {Promise<Entry[]>} */ (api.get(api.path(["journal"], query), { signal: this.stop.signal }));
  }

  /** From the newest end, after a change of the filter. */
  load() {
    this.wishes.add("fresh");
    this.state.hidden = false;
    setText(this.state, "Reading the journal …");
    this.reads.ask(null);
  }

  /** What is new, once what belongs together has come. */
  loadSoon() {
    if (this.timer) return;
    this.timer = setTimeout(() => {
      this.timer = 0;
      this.wishes.add("newest");
      this.reads.ask(null);
    }, AGAIN_MS);
  }

  loadOlder() {
    this.wishes.add("older");
    this.more.disabled = true;
    setText(this.more, "Loading …");
    this.reads.ask(null);
  }

  /** One reading after the other; one from the newest end does for all. */
  async work() {
    const wishes = new Set(this.wishes);
    this.wishes.clear();
    try {
      if (wishes.has("fresh")) return await this.readFresh();
      if (wishes.has("newest")) await this.readNewest();
      if (wishes.has("older")) await this.readOlder();
    } finally {
      this.more.disabled = false;
      setText(this.more, "Load older");
    }
  }

  async readFresh() {
    const page = await this.read({ before: null, limit: PAGE });
    if (this.wishes.has("fresh") || this.stop.signal.aborted) return;
    this.ended = page.length < PAGE;
    this.entries = withNewest(this.entries.filter((entry) => entry.live), page);
    this.show();
  }

  async readNewest() {
    const page = await this.read({ before: null, limit: PAGE });
    if (this.wishes.has("fresh") || this.stop.signal.aborted) return;
    // More happened than a page holds: begin anew rather than leave a hole.
    const known = this.entries.filter((entry) => !entry.live);
    const joins = known.length === 0 || page.length < PAGE || page[page.length - 1].at_ms <= known[0].at_ms;
    if (!joins) return this.load();
    this.entries = withNewest(this.entries, page).slice(0, MOST);
    this.show();
    // The daemon writes the journal twice a second: what is not in it yet may come.
    const now_ms = this.context.stream.daemonNow_ms();
    if (this.entries.some((entry) => entry.live && now_ms - entry.at_ms < LATE_MS)) this.loadSoon();
  }

  async readOlder() {
    for (let stuck = 0; ; stuck++) {
      const from = older(this.entries, PAGE, stuck);
      if (!from) return void this.load();
      const page = await this.read(from);
      if (this.wishes.has("fresh") || this.stop.signal.aborted) return;
      const before = this.entries.length;
      this.entries = withOlder(this.entries, page);
      this.ended = page.length < from.limit;
      if (this.entries.length > before || this.ended || from.limit >= MAX_OF_PAGE) break;
    }
    this.show();
    this.context.announce(`${this.entries.length} entries loaded`);
  }

  /** @param {unknown} why */
  failed(why) {
    this.state.hidden = false;
    const again = h("button", { type: "button", on: { click: () => this.load() } }, "Try again");
    this.state.replaceChildren(`The journal cannot be read: ${why instanceof Error ? why.message : why}. `, again);
  }

  /** @param {any[]} notices */
  noticed(notices) {
    const told = notices.map(fromNotice).filter((entry) => entry !== null);
    if (told.length === 0) return;
    this.entries = [...told.reverse(), ...this.entries].sort((a, b) => b.at_ms - a.at_ms).slice(0, MOST);
    this.show();
    this.loadSoon();
  }

  typed() {
    clearTimeout(this.typing);
    this.typing = setTimeout(() => this.show(), 150);
  }

  clear() {
    for (const control of [this.kind, this.text, this.since, this.before]) control.value = "";
    this.device.value = "*";
    this.load();
  }

  /** @returns {Entry[]} */
  seen() {
    const filter = this.filter();
    return this.entries.filter((entry) => matches(entry, filter));
  }

  show() {
    this.fillChoices();
    const seen = this.seen();
    this.state.hidden = true;
    // Rows that stay are the same elements: only what is new is laid out.
    const wanted = seen.map((entry) => this.rowOf(entry));
    const kept = new Set(wanted);
    for (const row of [...this.body.children]) if (!kept.has(/** @type {HTMLElement} */ (row))) row.remove();
    wanted.forEach((row, k) => {
      if (this.body.children[k] !== row) this.body.insertBefore(row, this.body.children[k] ?? null);
    });
    const full = this.entries.length >= MOST;
    this.more.hidden = this.ended || full;
    setText(this.end, this.endWords(seen.length, full));
  }

  /** @param {number} seen @param {boolean} full */
  endWords(seen, full) {
    const all = this.entries.length;
    const shown = this.text.value.trim() ? `${seen} of ${all} entries that were loaded hold these words` : `${seen} ${seen === 1 ? "entry" : "entries"}`;
    if (seen === 0 && this.ended) return "Nothing has happened yet that this filter lets through.";
    if (full) return `${shown}. More than ${MOST} are not loaded: choose an earlier time in To.`;
    return this.ended ? `${shown}. There are no older ones.` : `${shown}.`;
  }

  /** @param {Entry} entry */
  rowOf(entry) {
    let row = this.rows.get(entry);
    if (!row) {
      row = line(entry);
      this.rows.set(entry, row);
    }
    return row;
  }

  save() {
    const rows = this.seen().map((entry) => [isoUtc(entry.at_ms), entry.device, entry.kind, entry.holder, entry.text]);
    const { device, kind, text, since_ms, before_ms } = this.filter();
    const filter = [
      device === null ? "" : `device ${device || "none, the daemon itself"}`,
      kind && `kind ${kind}`,
      text && `text ${text}`,
      since_ms !== null && `from ${isoUtc(since_ms)}`,
      before_ms !== null && `to ${isoUtc(before_ms)}`,
    ].filter(Boolean);
    const remarks = [`events, newest first; ${filter.length ? filter.join(", ") : "not filtered"}`, `saved ${isoUtc(Date.now())}`];
    downloadCsv(fileName(["events"], Date.now(), "csv"), csv(remarks, ["time_utc", "device", "kind", "holder", "text"], rows));
  }
}

/** @param {Entry} entry @returns {HTMLElement} */
function line(entry) {
  const alarm = isAlarm(entry);
  return h(
    "tr",
    { class: alarm ? "events-alarm" : null, data: { kind: entry.kind } },
    h("td", { class: "events-time", title: isoUtc(entry.at_ms) }, dateTime(entry.at_ms)),
    h("td", { class: "events-device" }, entry.device || h("span", { class: "quiet" }, "daemon")),
    h("td", { class: "events-kind" }, alarm ? h("span", { class: "events-sign", role: "img", "aria-label": "alarm" }, "▲") : null, entry.kind),
    h("td", { class: "events-holder" }, entry.holder),
    h("td", { class: "events-what" }, entry.text, entry.live ? h("span", { class: "events-live", title: "told just now; the journal does not hold it" }, "live") : null),
  );
}
