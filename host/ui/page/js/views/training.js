// @ts-check
/** How the network came to what it says: fits of the last windows, the gate's verdicts and why, the steps of one of them. */

import { append, h, setAttribute, setText } from "../dom.js";
import { csv, downloadCsv, fileName } from "../export.js";
import { clock, dateTime, isoUtc, NOTHING, si } from "../format.js";
import { Newest } from "../newest.js";
import { Plot } from "../plot.js";
import { Detail, pct, verdictSign } from "../training/detail.js";
import { keyOf, verdicts, withNewest } from "../training/fits.js";

/** Fits that are read again when there is something new; more only where that leaves a hole. */
const NEWEST = 30;

/** Between two readings while results come, in milliseconds. */
const AGAIN_MS = 1500;

/** @typedef {import("../context.js").Context} Context */
/** @typedef {import("../training/fits.js").Fit} Fit */

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
  const view = new TrainingView(root, context);
  return { unmount: () => view.unmount() };
}

class TrainingView {
  /** @type {Detail} */
  detail;
  /** @type {Plot} */
  errorPlot;

  /** @param {HTMLElement} root @param {Context} context */
  constructor(root, context) {
    this.context = context;
    this.device = context.device;
    /** @type {Fit[]} newest first */
    this.fits = [];
    /** @type {string | null} key of the chosen fit; null follows the newest */
    this.chosen = null;
    this.limit = 50;
    this.whole = false;
    this.timer = 0;
    this.read_ms = -Infinity;
    /** @type {Map<string, any>} */
    this.rows = new Map();
    this.stop = new AbortController();
    this.reads = new Newest(() => this.read(), (why) => this.failed(why));
    this.build(root);
    this.ends = [
      context.stream.on("notice", (notice) => {
        if (notice.device === this.device && notice.event === "result-stored") this.loadSoon();
      }),
      context.stream.on("gap", () => this.load(true)),
    ];
    this.visible = () => !document.hidden && this.loadSoon();
    document.addEventListener("visibilitychange", this.visible);
    this.load(true);
  }

  unmount() {
    this.reads.stop();
    this.stop.abort();
    clearTimeout(this.timer);
    document.removeEventListener("visibilitychange", this.visible);
    for (const end of this.ends) end();
    this.detail.destroy();
    this.errorPlot.destroy();
  }

  /** @param {HTMLElement} root */
  build(root) {
    this.state = h("p", { class: "training-state quiet", role: "status" }, "Reading what was learned …");
    this.limitSelect = h("select", { on: { change: () => this.chooseLimit() } }, [50, 200, 1000].map((n) => h("option", { value: String(n) }, `last ${n}`)));
    this.follow = h("button", { type: "button", "aria-pressed": "true", on: { click: () => this.choose(null) } }, "Newest");
    const save = h("button", { type: "button", "aria-label": "Save the fits as CSV", on: { click: () => this.save() } }, "CSV");
    this.summary = h("div", { class: "training-verdicts" });
    this.body = h("tbody", { on: { keydown: (/** @type {KeyboardEvent} */ event) => this.key(event) } });
    const head = ["Time", "f_sw", "R", "L", "σ R", "σ L", "Steps", "Took", "Verdict"];
    const table = h(
      "table",
      { class: "training-table" },
      h("caption", { class: "unseen" }, "Fits, newest first; the time chooses one"),
      h("thead", null, h("tr", null, head.map((text) => h("th", { scope: "col" }, text)))),
      this.body,
    );
    this.scroll = h("div", { class: "training-scroll", tabindex: "0", role: "region", "aria-label": "Fits" }, table);
    this.detail = new Detail(this.context);
    this.errorBox = h("section", { class: "training-plot training-errors", "aria-label": "Fits that passed, over time" });
    this.noTruth = h("p", { class: "quiet" });
    this.errorBox.append(this.noTruth);
    this.content = h("div", { class: "training-content", hidden: true }, this.summary, h("div", { class: "training-columns" }, this.scroll, this.detail.element), this.errorBox);
    append(root, [
      h(
        "div",
        { class: "training-head" },
        h("h1", null, `Training of ${this.device}`),
        h("span", { class: "training-tools" }, h("label", null, h("span", { class: "unseen" }, "How many fits"), this.limitSelect), this.follow, save),
      ),
      this.state,
      this.content,
    ]);
    this.plots();
  }

  plots() {
    const { theme, announce } = this.context;
    this.errorPlot = new Plot(this.errorBox, {
      theme,
      announce,
      device: () => this.device,
      title: "Fits that passed: error against the truth, 2 σ",
      name: "training-errors",
      x: { label: "time", unit: "local", time: true },
      axes: [{ key: "pct", label: "of R, L", unit: "%" }],
      series: [
        { label: "error of R", axis: "pct", colour: "s1", marker: "circle", line: false, digits: 3 },
        { label: "error of L", axis: "pct", colour: "s2", marker: "square", line: false, digits: 3 },
        { label: "2 σ of R", axis: "pct", colour: "s1", dash: [6, 4], digits: 3 },
        { label: "2 σ of L", axis: "pct", colour: "s2", dash: [2, 3], digits: 3 },
      ],
      height: () => 200,
    });
  }

  loadSoon() {
    if (this.timer || document.hidden) return;
    this.timer = setTimeout(
      () => {
        this.timer = 0;
        this.load(false);
      },
      Math.max(AGAIN_MS - (performance.now() - this.read_ms), 0),
    );
  }

  /** @param {boolean} whole the whole list; otherwise what is new in it */
  load(whole) {
    // A wish for the newest does not take the place of one for all.
    this.whole ||= whole;
    this.reads.ask(null);
  }

  async read() {
    const { api } = this.context;
    const whole = this.whole;
    const limit = whole ? this.limit : Math.min(NEWEST, this.limit);
    this.whole = false;
    this.read_ms = performance.now();
    /** @type {Fit[]} */
    const page = await api.get(api.path(["devices", this.device, "training"], { limit }), { signal: this.stop.signal });
    if (this.stop.signal.aborted) return;
    const { list, hole } = withNewest(whole ? [] : this.fits, page, this.limit);
    if (hole) return this.load(true);
    this.fits = list;
    this.show();
  }

  /** @param {unknown} why */
  failed(why) {
    const again = h("button", { type: "button", on: { click: () => this.load(true) } }, "Try again");
    this.state.hidden = false;
    this.state.replaceChildren(`The fits cannot be read: ${why instanceof Error ? why.message : why}. `, again);
  }

  chooseLimit() {
    this.limit = Number(this.limitSelect.value);
    this.load(true);
  }

  show() {
    const none = this.fits.length === 0;
    this.state.hidden = !none;
    this.content.hidden = none;
    if (none) {
      setText(this.state, "Nothing was learned yet. Heat the pot: each window that comes is fitted, and stands here with the gate's verdict.");
      return;
    }
    this.showSummary();
    this.showRows();
    this.showDetail();
    this.showErrors();
  }

  showSummary() {
    const { passed, refused, reasons } = verdicts(this.fits);
    const all = this.fits.length;
    const count = (/** @type {string} */ sign, /** @type {string} */ kind, /** @type {number} */ n, /** @type {string} */ text) =>
      h("span", { class: `training-count ${kind}` }, h("span", { "aria-hidden": "true" }, sign), ` ${n} ${text}`);
    this.summary.replaceChildren(
      h("span", { class: "quiet" }, `Of the last ${all}:`),
      count("✓", "good", passed, "passed"),
      count("✕", refused ? "bad" : "quiet", refused, refused && reasons.length ? "refused:" : "refused"),
      ...reasons.slice(0, 8).map(({ reason, count: n }) => h("span", { class: "training-reason", title: reason }, `${n} × ${reason}`)),
      ...(reasons.length > 8 ? [h("span", { class: "quiet" }, `and ${reasons.length - 8} further reasons`)] : []),
    );
  }

  /** Rows stay the same elements, so that neither focus nor place in the list is lost. */
  showRows() {
    const kept = new Set(this.fits.map(keyOf));
    for (const [key, row] of this.rows) {
      if (kept.has(key)) continue;
      row.remove();
      this.rows.delete(key);
    }
    const atTop = this.scroll.scrollTop < 4;
    const before = this.scroll.scrollHeight;
    this.fits.forEach((fit, k) => {
      const key = keyOf(fit);
      let row = this.rows.get(key);
      if (!row) {
        row = this.row(fit);
        this.rows.set(key, row);
      }
      if (this.body.children[k] !== row) this.body.insertBefore(row, this.body.children[k] ?? null);
    });
    if (!atTop) this.scroll.scrollTop += this.scroll.scrollHeight - before;
    this.mark();
  }

  /** @param {Fit} fit */
  row(fit) {
    const number = (/** @type {string} */ text) => h("td", { class: "number" }, text);
    const pick = h(
      "button",
      { type: "button", class: "training-pick", title: dateTime(fit.at_ms), data: { key: keyOf(fit) }, on: { click: () => this.choose(keyOf(fit)) } },
      clock(fit.at_ms),
    );
    return h(
      "tr",
      { class: fit.pass ? null : "training-refused" },
      h("th", { scope: "row" }, pick),
      number(si(fit.f_sw_hz, "Hz", 4)),
      number(si(fit.r_ohm, "Ω", 4)),
      number(si(fit.l_h, "H", 4)),
      number(pct(fit.sigma_r_pct)),
      number(pct(fit.sigma_l_pct)),
      number(String(fit.iterations)),
      number(fit.seconds === null ? NOTHING : si(fit.seconds, "s", 3)),
      h("td", { class: "training-why" }, verdictSign(fit), fit.pass ? (fit.changed_lookup ? "passed, changed the lookup" : "passed") : fit.why || "refused"),
    );
  }

  mark() {
    const current = this.current;
    for (const [key, row] of this.rows) {
      const on = current !== undefined && key === keyOf(current);
      row.classList.toggle("training-chosen", on);
      setAttribute(row.querySelector("button"), "aria-pressed", String(on));
    }
    setAttribute(this.follow, "aria-pressed", String(this.chosen === null));
  }

  /** The chosen fit; the newest where none is, or where it has left the list. @returns {Fit | undefined} */
  get current() {
    return this.fits.find((fit) => keyOf(fit) === this.chosen) ?? this.fits[0];
  }

  /** @param {string | null} key null follows the newest */
  choose(key) {
    this.chosen = key;
    if (this.fits.length === 0) return;
    this.mark();
    this.showDetail();
    if (key === null) this.scroll.scrollTop = 0;
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -1e9, End: 1e9 }[event.key];
    const at = this.fits.findIndex((fit) => keyOf(fit) === /** @type {HTMLElement} */ (event.target).dataset.key);
    if (step === undefined || at < 0) return;
    event.preventDefault();
    const to = keyOf(this.fits[Math.min(Math.max(at + step, 0), this.fits.length - 1)]);
    this.choose(to);
    this.rows.get(to)?.querySelector("button").focus();
  }

  showDetail() {
    if (this.current) this.detail.show(this.current);
  }

  showErrors() {
    // What the gate refused would hide the others: its numbers stand in the list.
    const oldest = this.fits.filter((fit) => fit.pass).reverse();
    const of = (/** @type {(fit: Fit) => number | null} */ value) => oldest.map(value);
    const twice = (/** @type {number | null} */ sigma) => (sigma === null ? null : 2 * sigma);
    const known = oldest.length > 1;
    this.errorBox.hidden = !known;
    if (!known) return;
    const truth = oldest.some((fit) => fit.r_error_pct !== null);
    setText(this.noTruth, truth ? "" : "There is no truth to compare with: the device is not simulated in the daemon itself.");
    this.errorPlot.set(
      [of((fit) => fit.at_ms / 1000), of((fit) => fit.r_error_pct), of((fit) => fit.l_error_pct), of((fit) => twice(fit.sigma_r_pct)), of((fit) => twice(fit.sigma_l_pct))],
      oldest[oldest.length - 1].at_ms,
    );
  }

  save() {
    const head = ["time_utc", "boot", "seq", "f_sw_hz", "r_ohm", "l_h", "sigma_r_pct", "sigma_l_pct", "r_error_pct", "l_error_pct", "pass", "why", "remarks", "changed_lookup", "steps", "seconds"];
    const rows = this.fits.map((fit) => [
      isoUtc(fit.at_ms), fit.boot, fit.seq, fit.f_sw_hz, fit.r_ohm, fit.l_h, fit.sigma_r_pct, fit.sigma_l_pct, fit.r_error_pct, fit.l_error_pct,
      fit.pass, fit.why, fit.remarks.map((remark) => remark.code).join(" "), fit.changed_lookup, fit.iterations, fit.seconds,
    ]);
    const remarks = [`fits of ${this.device}, newest first`, `saved ${isoUtc(Date.now())}`];
    downloadCsv(fileName([this.device, "training"], Date.now(), "csv"), csv(remarks, head, rows));
  }
}
