// @ts-check
/** The last window: v(t), i(t) as on an oscilloscope, R(t) and L(t) below, what a scope would measure beside. */

import { h, setText } from "../dom.js";
import { dateTime, fixed, si } from "../format.js";
import { Newest } from "../newest.js";
import { Plot } from "../plot.js";
import { MeasuredTable } from "./measured.js";
import { Persistence } from "./persistence.js";
import { loadAxes, loadData, loadSeries, scopeData, scopeTable } from "./scope-data.js";

/** Windows that run by are drawn at most this often, in milliseconds. */
const RUN_MS = 500;

/** While the network judges windows, those that it has not judged yet are not shown; this long after its last word they are. */
const RESULT_WAIT_MS = 3000;

export class ScopeView {
  /**
   * @param {HTMLElement} root
   * @param {import("../context.js").Context} context
   */
  constructor(root, context) {
    this.context = context;
    /** @type {any} the window that is shown */
    this.scope = null;
    /** @type {{from: number, to: number} | null} what a person zoomed to, in seconds */
    this.view = null;
    /** "run": newest ones come by; "single": the next one, then hold; "hold". */
    this.mode = "run";
    /** The one that was judged last: the newest one has no word of the network yet. @type {{boot: number, seq: number} | null} */
    this.judged = null;
    this.judged_ms = -Infinity;
    /** @type {{boot: number, seq: number} | null} the one that is held */
    this.held = null;
    this.lastRun_ms = 0;
    /** @type {any} */
    this.runTimer = 0;
    this.persistence = new Persistence(0);
    this.loader = new Newest((wish, signal) => this.#load(wish, signal), (why) => this.#say(why));
    this.measured = new MeasuredTable();
    const { plots, loads } = this.#build(root);
    const [wave, r, l] = this.#buildPlots(plots, loads);
    this.wave = wave;
    this.r = r;
    this.l = l;
    this.#showMode();
    this.stops = [
      context.stream.frame("notice", (notices) => this.#notices(notices)),
      context.stream.on("gap", () => this.mode === "run" && this.#ask()),
    ];
    this.#ask();
  }

  /** Ends it. */
  stop() {
    clearTimeout(this.runTimer);
    this.loader.stop();
    for (const stop of this.stops) stop();
    for (const plot of [this.wave, this.r, this.l]) plot.destroy();
  }

  /**
   * @param {HTMLElement} root
   * @returns {{plots: HTMLElement, loads: HTMLElement}}
   */
  #build(root) {
    const button = (/** @type {string} */ label, /** @type {string} */ testid, /** @type {() => void} */ click, /** @type {string} */ title) =>
      h("button", { type: "button", class: "small", title, data: { testid }, on: { click } }, label);
    this.runButton = button("Run", "scope-run", () => this.#setMode("run"), "shows windows as they come");
    this.holdButton = button("Hold", "scope-hold", () => this.#setMode("hold"), "keeps the window that is shown");
    this.singleButton = button("Single", "scope-single", () => this.#setMode("single"), "waits for the next window, and holds it");
    this.olderButton = button("◂ older", "scope-older", () => this.#step(1), "the window before");
    this.newerButton = button("newer ▸", "scope-newer", () => this.#step(-1), "the window after");
    this.persist = h("select", { "aria-label": "Persistence", title: "windows before that are drawn below, fading", on: { change: () => this.#setPersistence() } },
      [0, 4, 16].map((n) => h("option", { value: String(n) }, n === 0 ? "no persistence" : `last ${n}`)));
    this.what = h("span", { class: "quiet scope-what", data: { testid: "scope-what" } });
    this.verdict = h("p", { class: "scope-verdict", data: { testid: "scope-verdict" } });
    const plots = h("div", { class: "scope-plots" });
    const loads = h("div", { class: "scope-loads" });
    root.append(
      h("div", { class: "scope-head" }, h("h2", {}, "Last window"), this.runButton, this.holdButton, this.singleButton, this.olderButton, this.newerButton, this.persist, this.what),
      h("div", { class: "scope-body" }, plots, this.measured.root),
      this.verdict, loads);
    return { plots, loads };
  }

  /**
   * @param {HTMLElement} plots
   * @param {HTMLElement} loads
   * @returns {[Plot, Plot, Plot]}
   */
  #buildPlots(plots, loads) {
    const { theme, announce, device } = this.context;
    const view = this;
    const shared = {
      theme, announce, device: () => device, x: { label: "t", unit: "ms", factor: 1e3 }, sync: "scope",
      onView: (/** @type {any} */ wanted) => this.#zoom(wanted),
      get bounds() {
        return { from: 0, to: view.scope?.duration_s ?? 0.01 };
      },
    };
    const wave = new Plot(plots, withBounds(shared, {
      title: "v(t), i(t)", name: "window", height: () => share(wide() ? 0.44 : 0.3, 250, 1000),
      axes: [{ key: "v", label: "v", unit: "V", range: symmetric(1.05) }, { key: "i", label: "i", unit: "A", side: "right", range: symmetric(1.6) }],
      series: [
        { label: "v coil", axis: "v", colour: "s1", width: 1, digits: 1 },
        { label: "i coil", axis: "i", colour: "s2", width: 1, digits: 2, dash: [] },
      ],
      under: [(/** @type {any} */ u, /** @type {any} */ t) => this.persistence.draw(u, t, this.scope)],
      table: () => scopeTable(this.scope),
    }));
    const r = new Plot(loads, withBounds(shared, {
      title: "R(t)", name: "r-of-t", height: () => share(wide() ? 0.32 : 0.18, 160, 700), axes: loadAxes("R"), series: loadSeries("R"),
      bands: [{ high: 3, low: 4, colour: "b1" }],
    }));
    const l = new Plot(loads, withBounds(shared, {
      title: "L(t)", name: "l-of-t", height: () => share(wide() ? 0.32 : 0.18, 160, 700), axes: loadAxes("L"), series: loadSeries("L"),
      bands: [{ high: 3, low: 4, colour: "b1" }],
    }));
    return [wave, r, l];
  }

  /** @param {any[]} notices */
  #notices(notices) {
    if (this.mode === "hold") return;
    const own = notices.filter((notice) => notice.device === this.context.device);
    const result = own.findLast((notice) => notice.event === "result-stored");
    if (result) {
      this.judged = { boot: result.boot, seq: result.seq };
      this.judged_ms = performance.now();
      this.#soon(0);
    } else if (own.some((notice) => notice.event === "window-stored") && performance.now() - this.judged_ms > RESULT_WAIT_MS) {
      this.#soon(RESULT_WAIT_MS);
    }
  }

  /**
   * The newest window, not more often than {@link RUN_MS}.
   * @param {number} wait_ms
   */
  #soon(wait_ms) {
    const earliest = Math.max(wait_ms, this.lastRun_ms + RUN_MS - performance.now());
    if (this.runTimer && wait_ms > 0) return;
    clearTimeout(this.runTimer);
    this.runTimer = setTimeout(() => {
      this.runTimer = 0;
      this.lastRun_ms = performance.now();
      if (this.mode !== "hold" && !document.hidden) this.#ask();
    }, earliest);
  }

  #ask() {
    const which = this.mode === "hold" ? this.held : this.judged;
    this.judged = null;
    this.loader.ask({ which, view: this.view, columns: this.wave.columns() });
  }

  /**
   * @param {{which: {boot: number, seq: number} | null, view: {from: number, to: number} | null, columns: number}} wish
   * @param {AbortSignal} signal
   */
  async #load(wish, signal) {
    const { api, device } = this.context;
    if (!this.scope && !wish.which && (await api.get(api.path(["devices", device, "windows"], { limit: 1 }), { signal })).length === 0) {
      this.#say({ error: "no-window" });
      return;
    }
    const query = { boot: wish.which?.boot, seq: wish.which?.seq, from_s: wish.view?.from, to_s: wish.view?.to, columns: wish.columns };
    const scope = await api.get(api.path(["devices", device, "window"], query), { signal }).catch((why) => {
      // Its samples were not kept: the newest that were.
      if (this.mode === "hold" || !wish.which || why.error !== "no-window") throw why;
      return api.get(api.path(["devices", device, "window"], { ...query, boot: null, seq: null }), { signal });
    });
    // One that was on its way when a person held another.
    if (this.mode === "hold" && this.scope && this.held && (scope.boot !== this.held.boot || scope.seq !== this.held.seq)) return;
    this.#show(scope, wish.view);
    if (this.mode === "single" && scope.seq !== this.singleFrom) this.#setMode("hold");
  }

  /**
   * @param {any} scope
   * @param {{from: number, to: number} | null} view
   */
  #show(scope, view) {
    this.persistence.push(this.scope, scope);
    this.scope = scope;
    this.wave.set(scopeData(scope), scope.at_ms);
    this.r.set(loadData(scope, "R"), scope.at_ms);
    this.l.set(loadData(scope, "L"), scope.at_ms);
    const shown = view ?? { from: 0, to: scope.duration_s };
    for (const plot of [this.wave, this.r, this.l]) plot.show(this.view ?? shown);
    this.measured.show(scope);
    setText(this.what, `${scope.seq} of boot ${scope.boot} · ${dateTime(scope.at_ms)} · ${si(scope.f_sw_hz, "Hz", 4)} · ${scope.pairs} pairs at ${si(scope.sample_rate_hz, "S/s", 3)}${scope.decimated ? ", least and largest of each column" : ""}${scope.saturated ? ` · ${scope.saturated} pairs at the end of the range` : ""}`);
    this.#showVerdict(scope);
  }

  /** @param {any} scope */
  #showVerdict(scope) {
    const means = scope.r_mean_ohm !== null && scope.l_mean_h !== null
      ? ` R, mean ${si(scope.r_mean_ohm, "Ω", 4)}${error(scope.r_mean_ohm, scope.r_true_mean_ohm)}, L, mean ${si(scope.l_mean_h, "H", 4)}${error(scope.l_mean_h, scope.l_true_mean_h)}.`
      : "";
    const verdict = scope.pass === null || scope.pass === undefined
      ? "The network has not fitted this window."
      : scope.pass ? "✔ The gate let the network's result pass." : `✖ The gate refused the network's result: ${scope.why}.`;
    setText(this.verdict, verdict + means);
    this.verdict.className = `scope-verdict ${scope.pass === false ? "warn" : ""}`;
  }

  /** @param {{from: number, to: number} | null} wanted */
  #zoom(wanted) {
    this.view = wanted;
    this.persistence.clear();
    const shown = wanted ?? { from: 0, to: this.scope?.duration_s ?? 0.01 };
    for (const plot of [this.wave, this.r, this.l]) plot.show(shown);
    this.#askSame();
  }

  /** The window that is shown, at another zoom. */
  #askSame() {
    const which = !this.scope ? null : { boot: this.scope.boot, seq: this.scope.seq };
    this.loader.ask({ which, view: this.view, columns: this.wave.columns() });
  }

  /** @param {"run" | "hold" | "single"} mode */
  #setMode(mode) {
    this.mode = mode;
    this.singleFrom = this.scope?.seq;
    this.held = mode === "hold" && this.scope ? { boot: this.scope.boot, seq: this.scope.seq } : null;
    this.#showMode();
    if (mode === "run") this.#ask();
  }

  #showMode() {
    this.holdButton.setAttribute("aria-pressed", String(this.mode === "hold"));
    this.runButton.setAttribute("aria-pressed", String(this.mode === "run"));
    this.singleButton.setAttribute("aria-pressed", String(this.mode === "single"));
    setText(this.singleButton, this.mode === "single" ? "Waiting …" : "Single");
  }

  #setPersistence() {
    this.persistence = new Persistence(Number(this.persist.value));
    this.wave.redraw();
  }

  /**
   * Holds the window so many places older than the one that is shown.
   * @param {number} places
   */
  async #step(places) {
    const { api, device } = this.context;
    try {
      const list = (await api.get(api.path(["devices", device, "windows"], { limit: 1000 }))).filter((/** @type {any} */ one) => one.samples);
      const shown = this.scope;
      const here = list.findIndex((/** @type {any} */ one) => shown && one.boot === shown.boot && one.seq === shown.seq);
      const target = list[Math.min(list.length - 1, Math.max(0, (here < 0 ? 0 : here) + places))];
      if (!target) return;
      this.persistence.clear();
      this.mode = "hold";
      this.held = { boot: target.boot, seq: target.seq };
      this.#showMode();
      this.#ask();
    } catch (why) {
      this.#say(why);
    }
  }

  /** @param {any} why */
  #say(why) {
    const none = why?.error === "no-window";
    setText(this.what, none ? "no window is stored yet: they come while it heats" : `the window could not be read: ${why?.message ?? why}`);
  }
}

/** Whether R(t) and L(t) stand beside each other, and the past in a column of its own (css/live.css). */
function wide() {
  return innerWidth >= 2400;
}

/**
 * A height that grows with the window.
 * @param {number} part
 * @param {number} least
 * @param {number} most
 * @returns {number}
 */
function share(part, least, most) {
  return Math.min(most, Math.max(least, part * innerHeight));
}

/**
 * Options with a getter kept as one.
 * @param {any} shared
 * @param {any} own
 */
function withBounds(shared, own) {
  return Object.defineProperties({ ...own }, Object.getOwnPropertyDescriptors(shared));
}

/**
 * A range that has zero in its middle, so that both axes share it; the current's is wider, so that it covers less of the
 * voltage.
 * @param {number} room
 * @returns {(least: number | null, most: number | null) => [number, number]}
 */
function symmetric(room) {
  return (least, most) => {
    const size = room * Math.max(1e-3, Math.abs(least ?? 1), Math.abs(most ?? 1));
    return [-size, size];
  };
}

/**
 * @param {number} value
 * @param {number | null} truth
 * @returns {string}
 */
function error(value, truth) {
  return truth ? ` (${fixed((100 * (value - truth)) / truth, 2)} % from the truth)` : "";
}
