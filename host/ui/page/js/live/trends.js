// @ts-check
/** Power, R, L, frequency and phase over minutes and hours: from the store, grown by the live stream. */

import { h, setText } from "../dom.js";
import { dateTime, duration } from "../format.js";
import { Newest } from "../newest.js";
import { TrendColumns } from "./trend-columns.js";
import { TrendPlots } from "./trend-plots.js";

/**
 * Lengths to choose, in seconds; how often each is drawn, in milliseconds: about once a pixel; and how often it is read
 * anew: the store has means of all half-cycles, where the stream has the last of an interval. The last minute stays as
 * the stream brought it, which is finer than the store.
 */
const LENGTHS = /** @type {const} */ ([
  { seconds: 60, label: "1 min", draw_ms: 500, read_ms: Infinity },
  { seconds: 300, label: "5 min", draw_ms: 1000, read_ms: 20_000 },
  { seconds: 3600, label: "1 h", draw_ms: 2000, read_ms: 120_000 },
  { seconds: 86_400, label: "24 h", draw_ms: 10_000, read_ms: 600_000 },
]);

/** Furthest back that a person may zoom out, in seconds. */
const FURTHEST_S = 40 * 86_400;

/** New results are read this often at most, in milliseconds. */
const RESULTS_MS = 2000;

/** Between two intervals of the live stream, in milliseconds. */
const LIVE_MS = 200;

/** Most intervals that wait for a history. */
const MAX_MEANWHILE = 500;

const KEY = "ihd-trend-seconds";

/** @returns {string | null} length that was chosen last, in seconds */
function rememberedLength() {
  try {
    return sessionStorage.getItem(KEY);
  } catch {
    return null;
  }
}

export class Trends {
  /**
   * @param {HTMLElement} root
   * @param {import("../context.js").Context} context
   */
  constructor(root, context) {
    this.context = context;
    this.columns = new TrendColumns();
    this.length = LENGTHS.find((one) => String(one.seconds) === rememberedLength()) ?? LENGTHS[1];
    /** @type {{from: number, to: number} | null} what a person zoomed to, in seconds since 1970; null: it follows */
    this.view = null;
    /** Time of the last telemetry: the daemon's clock, which a past is asked for by. */
    this.at_ms = context.stream.lastAt_ms || Infinity;
    this.drawn_ms = 0;
    this.read_ms = 0;
    this.paused = false;
    /** Telemetry of while a history is under way: it goes on where that ends. @type {[number, any][]} */
    this.meanwhile = [];
    this.results = new Newest((since_ms, signal) => this.#loadResults(since_ms, signal), () => {});
    this.loader = new Newest((wish, signal) => this.#load(wish, signal), (why) => this.#failed(why));
    this.lengthButtons = LENGTHS.map((one) =>
      h("button", { type: "button", class: "small", data: { testid: `trend-${one.seconds}` }, on: { click: () => this.#setLength(one) } }, one.label));
    this.plots = this.#build(root);
    this.#showLength();
    this.stops = [
      context.stream.on("telemetry", (event) => this.#telemetry(event)),
      context.stream.on("notice", (notice) => this.#notice(notice)),
      context.stream.on("gap", () => this.#ask()),
      context.stream.frame("telemetry", () => this.#drawSoon()),
    ];
    if (context.stream.lastAt_ms) this.#ask();
  }

  /** Ends it. */
  stop() {
    this.loader.stop();
    this.results.stop();
    clearTimeout(this.resultTimer);
    for (const stop of this.stops) stop();
    this.plots.destroy();
  }

  /**
   * @param {HTMLElement} root
   * @returns {TrendPlots}
   */
  #build(root) {
    this.pauseButton = h("button", { type: "button", class: "small", "aria-pressed": "false", title: "these plots stand still; nothing is lost", data: { testid: "pause" }, on: { click: () => this.#pause() } }, "Pause");
    this.limits = h("input", { type: "checkbox", id: "trend-limits", checked: true, on: { change: () => this.plots.showLimits(this.limits.checked) } });
    this.says = h("span", { class: "quiet", data: { testid: "trend-says" } });
    root.append(h("div", { class: "scope-head" },
      h("h2", {}, "Past"), h("span", { role: "group", "aria-label": "Length", class: "lengths" }, this.lengthButtons), this.pauseButton,
      h("label", { class: "check" }, this.limits, " limits in view"), this.says));
    return new TrendPlots(root, this.context, this.columns, {
      zoom: (view) => this.#zoom(view),
      bounds: () => {
        const now_s = this.context.stream.daemonNow_ms() / 1000;
        return { from: now_s - FURTHEST_S, to: now_s };
      },
    });
  }

  /** @returns {{from: number, to: number}} what is to be seen, in seconds since 1970 */
  #wanted() {
    if (this.view) return this.view;
    const now_s = this.context.stream.daemonNow_ms() / 1000;
    return { from: now_s - this.length.seconds, to: now_s };
  }

  #ask() {
    const { from, to } = this.#wanted();
    this.meanwhile = [];
    this.asking = true;
    this.read_ms = performance.now();
    this.loader.ask({ from_ms: Math.floor(from * 1000), to_ms: this.view ? Math.ceil(to * 1000) : null, columns: this.plots.columnCount() });
  }

  /**
   * @param {{from_ms: number, to_ms: number | null, columns: number}} wish
   * @param {AbortSignal} signal
   */
  async #load(wish, signal) {
    const { api, device } = this.context;
    const history = await api.get(api.path(["devices", device, "history"], { from: wish.from_ms, to: wish.to_ms, columns: wish.columns }), { signal });
    this.columns.load(history, Math.max(LIVE_MS, (this.length.seconds * 1000) / 600));
    this.asking = this.loader.waiting !== null;
    if (!this.view) {
      for (const [at_ms, one] of this.meanwhile) if (at_ms > history.to_ms) this.columns.append(at_ms, one);
      this.meanwhile = [];
    }
    this.#draw();
    this.#saySeen(history);
  }

  /** @param {any} history */
  #saySeen(history) {
    const { from, to } = this.#wanted();
    const empty = history.at_ms.length === 0 ? "nothing is known of this stretch; " : "";
    const where = this.view ? `${dateTime(from * 1000)} to ${dateTime(to * 1000)}` : `the last ${duration(to - from)}`;
    this.#say(`${empty}${where}, least, mean and largest of ${history.step_ms < 1000 ? `${history.step_ms}\u00a0ms` : duration(history.step_ms / 1000)} a column; local time`);
  }

  /** @param {string} text */
  #say(text) {
    setText(this.says, text);
  }

  /** @param {import("../telemetry.js").Telemetry} event */
  #telemetry(event) {
    // The first one, or the clock was set back: what lies in its future goes.
    if (event.at_ms < this.at_ms) {
      this.columns.clear();
      this.#ask();
    }
    this.at_ms = event.at_ms;
    const one = event.devices[this.context.device];
    if (!one || this.view) return;
    if (this.asking && this.meanwhile.length < MAX_MEANWHILE) this.meanwhile.push([event.at_ms, one]);
    this.columns.append(event.at_ms, one);
  }

  /** @param {any} notice */
  #notice(notice) {
    const own = notice.event === "result-stored" && notice.device === this.context.device;
    if (!own || this.view || this.resultTimer || document.hidden) return;
    // Results of the store have their sigma; notices do not.
    this.resultTimer = setTimeout(() => {
      this.resultTimer = 0;
      if (this.view) return;
      const { at_s } = this.columns.results;
      this.results.ask(at_s.length ? Math.ceil(at_s[at_s.length - 1] * 1000) : Math.floor(this.#wanted().from * 1000));
    }, RESULTS_MS);
  }

  /**
   * @param {number} since_ms
   * @param {AbortSignal} signal
   */
  async #loadResults(since_ms, signal) {
    const { api, device } = this.context;
    const { results } = await api.get(api.path(["devices", device, "history"], { from: since_ms, columns: 20 }), { signal });
    if (this.view) return;
    for (let k = 0; k < results.at_ms.length; k += 1) {
      this.columns.appendResult({ at_ms: results.at_ms[k], r_ohm: results.r_ohm[k], l_h: results.l_h[k], sigma_r_pct: results.sigma_r_pct[k], sigma_l_pct: results.sigma_l_pct[k], pass: results.pass[k] });
    }
  }

  /** @type {any} */
  resultTimer = 0;

  /** @param {any} why */
  #failed(why) {
    this.asking = false;
    this.meanwhile = [];
    this.#say(`The past could not be read: ${why?.message ?? why}.`);
  }

  /** Following, as often as its length makes sense. */
  #drawSoon() {
    const now = performance.now();
    if (this.view || this.paused || now - this.drawn_ms < this.length.draw_ms - 20) return;
    this.#draw();
    if (now - this.read_ms > this.length.read_ms && !this.asking) this.#ask();
  }

  #draw() {
    this.drawn_ms = performance.now();
    const wanted = this.#wanted();
    if (!this.view) this.columns.dropBefore(wanted.from - 2 * (this.columns.step_ms / 1000));
    this.plots.draw(wanted);
  }

  /** @param {{from: number, to: number} | null} view */
  #zoom(view) {
    this.view = view;
    this.#showLength();
    this.plots.draw(this.#wanted());
    this.#ask();
  }

  /** @param {typeof LENGTHS[number]} one */
  #setLength(one) {
    this.length = one;
    try {
      sessionStorage.setItem(KEY, String(one.seconds));
    } catch {
      // Without storage it lasts as long as the view.
    }
    this.#zoom(null);
  }

  #showLength() {
    LENGTHS.forEach((one, i) => this.lengthButtons[i].setAttribute("aria-pressed", String(!this.view && one === this.length)));
  }

  #pause() {
    this.paused = !this.paused;
    this.pauseButton.setAttribute("aria-pressed", String(this.paused));
    setText(this.pauseButton, this.paused ? "Paused: go on" : "Pause");
  }
}
