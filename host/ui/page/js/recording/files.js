// @ts-check
/** The recordings that there are, and their downloads: as they are, or as tables that the daemon makes. */

import { append, h, setText } from "../dom.js";
import { download } from "../export.js";
import { bytes, dateTime } from "../format.js";
import { Newest } from "../newest.js";
import { nameOf } from "./settings.js";

/** The list is read again this often while something is recorded, in milliseconds. */
const AGAIN_MS = 3000;

/** Longest wait for a conversion, in milliseconds. */
const CONVERSION_MS = 15 * 60_000;

/** What a download holds, by format. */
const HOLDS = [
  ["MCAP", "everything that came: hello, telemetry, windows, faults, with their times. ihd replay, inspect and identify read it; Foxglove and PlotJuggler open it."],
  ["CSV", "the samples of all windows, one table: time_s, v_V, i_A, window (its number), times from the trigger on. Excel, readtable and numpy.genfromtxt read it. Windows are snapshots: between two of them there are no samples."],
  ["Half-cycles", "a line for each half-cycle: state, pot, fault, power, f_sw, crest, the device's own R and L, phase. CSV."],
  ["NPZ", "all of this as arrays, for numpy.load."],
];

/** Tables that the daemon makes of a recording, and their names here. */
const TABLES = [["csv", "CSV"], ["half-cycles", "Half-cycles"], ["npz", "NPZ"]];

/** @typedef {{file: string, device: string, at_ms: number, bytes: number, under_way: boolean}} RecordingFile */

export class Files {
  /** @param {import("../context.js").Context} context */
  constructor(context) {
    this.context = context;
    /** @type {RecordingFile[]} */
    this.files = [];
    /** @type {Map<string, {element: any, told: string}>} */
    this.rows = new Map();
    /** @type {Map<string, AbortController>} conversions under way */
    this.conversions = new Map();
    this.read_ms = -Infinity;
    this.ended = new AbortController();
    this.reads = new Newest(() => this.read(), (why) => this.failed(why));
    this.list = h("tbody", null);
    this.listState = h("p", { class: "quiet", role: "status" }, "Reading the list …");
    const head = ["File", "Device", "Written", "Size", "State", "Download"];
    this.table = h(
      "table",
      { class: "recordings-table", hidden: true },
      h("caption", { class: "unseen" }, "Recordings, newest first"),
      h("thead", null, h("tr", null, head.map((text) => h("th", { scope: "col" }, text)))),
      this.list,
    );
    this.elements = [
      h("h2", null, "Files"),
      h("dl", { class: "recordings-holds" }, HOLDS.map(([name, text]) => h("div", null, h("dt", null, name), h("dd", null, text)))),
      this.listState,
      h("div", { class: "recordings-scroll", tabindex: "0", role: "region", "aria-label": "Files" }, this.table),
    ];
  }

  /** Ends readings. Conversions go on: they belong to the page, not to the view. */
  stop() {
    this.reads.stop();
    this.ended.abort();
  }

  /** Reads again while a file grows. @param {boolean} recording whether something is being recorded */
  tick(recording) {
    const underWay = recording || this.files.some((file) => file.under_way);
    if (underWay && !document.hidden && performance.now() - this.read_ms > AGAIN_MS) this.load();
  }

  load() {
    this.reads.ask(null);
  }

  async read() {
    this.read_ms = performance.now();
    const files = await this.context.api.get("recordings", { signal: this.ended.signal });
    if (this.ended.signal.aborted) return;
    this.files = files;
    this.showFiles();
  }

  /** @param {unknown} why */
  failed(why) {
    this.listState.hidden = false;
    const again = h("button", { type: "button", on: { click: () => this.load() } }, "Try again");
    this.listState.replaceChildren(`The recordings cannot be listed: ${why instanceof Error ? why.message : why}. `, again);
  }

  showFiles() {
    const none = this.files.length === 0;
    this.listState.hidden = !none;
    this.table.hidden = none;
    if (none) setText(this.listState, "There are no recordings yet.");
    const names = new Set(this.files.map((file) => file.file));
    for (const [name, row] of this.rows) {
      if (names.has(name)) continue;
      row.element.remove();
      this.rows.delete(name);
    }
    this.files.forEach((file, k) => {
      const told = JSON.stringify(file);
      let row = this.rows.get(file.file);
      if (!row || row.told !== told) {
        const element = row?.element ?? h("tr", null);
        this.fillRow(element, file);
        row = { element, told };
        this.rows.set(file.file, row);
      }
      if (this.list.children[k] !== row.element) this.list.insertBefore(row.element, this.list.children[k] ?? null);
    });
  }

  /** Cells of numbers change while a file grows; its downloads stay, so that the focus does. @param {any} row @param {RecordingFile} file */
  fillRow(row, file) {
    const cells = [file.file, file.device || "–", dateTime(file.at_ms), bytes(file.bytes), file.under_way ? "being written" : "complete"];
    if (row.childElementCount === 0) {
      const kinds = ["recordings-file", "recordings-device", "recordings-time", "number", "recordings-state"];
      append(row, [cells.map((_, k) => h(k === 0 ? "th" : "td", { class: kinds[k], scope: k === 0 ? "row" : null })), h("td", { class: "recordings-downloads" }, this.downloads(file))]);
    }
    cells.forEach((text, k) => setText(row.children[k], text));
    row.classList.toggle("recordings-under-way", file.under_way);
  }

  /** @param {RecordingFile} file */
  downloads(file) {
    const { api } = this.context;
    const told = h("span", { class: "recordings-told", role: "status" });
    const mcap = h("a", { href: api.address(api.path(["recordings", file.file], { format: "mcap" })), download: file.file, "aria-label": `MCAP of ${file.file}` }, "MCAP");
    const converted = TABLES.map(([format, name]) => {
      const button = h("button", { type: "button", class: "small", "aria-label": `${name} of ${file.file}`, on: { click: () => this.convert(file, format, name, button, told) } }, name);
      return button;
    });
    return [mcap, converted, told];
  }

  /**
   * Asks for a conversion and hands it over; a second press ends it.
   * @param {RecordingFile} file
   * @param {string} format
   * @param {string} name of the format
   * @param {HTMLButtonElement} button
   * @param {HTMLElement} told
   */
  async convert(file, format, name, button, told) {
    const { api } = this.context;
    const key = `${file.file} ${format}`;
    const under = this.conversions.get(key);
    if (under) return under.abort();
    const conversion = new AbortController();
    this.conversions.set(key, conversion);
    setText(button, `cancel ${name}`);
    button.setAttribute("aria-label", `cancel ${name} of ${file.file}`);
    told.className = "recordings-told quiet";
    setText(told, "converting …");
    try {
      const limit = AbortSignal.any([conversion.signal, AbortSignal.timeout(CONVERSION_MS)]);
      const answer = await fetch(api.address(api.path(["recordings", file.file], { format })), { signal: limit, credentials: "same-origin", cache: "no-store" });
      if (!answer.ok) throw new Error((await answer.json().catch(() => null))?.message ?? `the daemon answered ${answer.status}`);
      setText(told, "downloading …");
      // The browser keeps a large blob on disk.
      download(nameOf(answer.headers.get("content-disposition")) ?? file.file.replace(/\.mcap$/, format === "npz" ? ".npz" : `.${format}.csv`), await answer.blob());
      setText(told, "");
      this.context.announce(`${file.file} was saved as ${name}`);
    } catch (why) {
      if (this.ended.signal.aborted) this.context.complain(`${file.file} is not saved as ${name}`, why);
      told.className = conversion.signal.aborted ? "recordings-told quiet" : "recordings-told bad";
      setText(told, conversion.signal.aborted ? "cancelled" : `${name}: ${why instanceof Error ? why.message : why}`);
    } finally {
      this.conversions.delete(key);
      setText(button, name);
      button.setAttribute("aria-label", `${name} of ${file.file}`);
    }
  }
}
