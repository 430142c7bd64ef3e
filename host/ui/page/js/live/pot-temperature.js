// @ts-check
/** How much warmer the pot is than when it was put on: number, curve with ± σ, and what R and L show of it. */

import { h, setAttribute, setText, svg } from "../dom.js";
import { fixed, moment, NOTHING } from "../format.js";

/** Between two requests of the curve, in milliseconds: one of an hour has 1800 points. */
const EVERY_MS = 5000;

/** The drawing's own units. */
const WIDTH = 300;
const HEIGHT = 90;

/** Least that the axis spans, in kelvin: noise is not a curve. */
const MIN_K = 20;

/**
 * @typedef {{since_ms: number, rise_k: number, sigma_k: number, prior_k: number, prior_sigma_k: number, lift_mm: number, lift_sigma_mm: number,
 *   bubbles: boolean, boils: boolean, overheats: boolean}} PotTemperature
 * @typedef {{at_ms: number, rise_k: number, sigma_k: number}} PotPoint
 */

export class PotTemperatureView {
  /**
   * @param {HTMLElement} root
   * @param {import("../context.js").Context} context
   */
  constructor(root, context) {
    this.context = context;
    this.number = h("span", { class: "live-number", data: { testid: "pot-rise" } }, NOTHING);
    this.says = h("p", { data: { testid: "pot-says" } });
    this.band = svg("polygon", { class: "pot-band" });
    this.line = svg("polyline", { class: "pot-line", "vector-effect": "non-scaling-stroke" });
    this.drawing = svg("svg", { class: "pot-curve", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", role: "img" }, this.band, this.line);
    this.scale = h("p", { class: "quiet" });
    root.append(h("section", { class: "panel live-pot", "aria-label": "Pot temperature" },
      h("dl", { class: "live-big" }, h("div", {}, h("dt", {}, "ΔT"), h("dd", {}, this.number))),
      this.says, this.drawing, this.scale));
    this.stopped = false;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
    this.#show(null);
    this.#draw([]);
    this.#ask();
  }

  /** Ends it. */
  stop() {
    this.stopped = true;
    clearTimeout(this.timer);
  }

  async #ask() {
    const { api, device } = this.context;
    try {
      const curve = document.hidden ? null : await api.get(api.path(["devices", device, "pot-temperature"]));
      if (this.stopped) return;
      if (curve) {
        this.#show(curve.now);
        this.#draw(curve.points);
      }
    } catch (why) {
      if (this.stopped) return;
      this.#show(null);
      setText(this.says, `not known: ${why instanceof Error ? why.message : why}`);
    }
    if (!this.stopped) this.timer = setTimeout(() => this.#ask(), EVERY_MS);
  }

  /** @param {PotTemperature | null} now */
  #show(now) {
    setText(this.number, now ? `${signed(now.rise_k)} ± ${fixed(now.sigma_k, 0)}\u00a0K` : NOTHING);
    setAttribute(this.number, "data-value", now ? String(now.rise_k) : "");
    setText(this.says, potWords(now));
    this.says.className = now?.overheats ? "bad" : "quiet";
  }

  /** @param {PotPoint[]} points */
  #draw(points) {
    const { band, line, label } = outline(points);
    setAttribute(this.band, "points", band);
    setAttribute(this.line, "points", line);
    setText(this.scale, label);
    setAttribute(this.drawing, "aria-label", label || "no curve yet");
  }
}

/**
 * @param {PotTemperature | null} now
 * @returns {string}
 */
export function potWords(now) {
  if (!now) return "not known: it is followed from when heating begins";
  const states = [now.overheats && "overheats", now.boils && "boils", now.bubbles && !now.boils && "bubbles at its base"].filter(Boolean);
  const prior = `by its heat alone ${signed(now.prior_k)} ± ${fixed(now.prior_sigma_k, 0)}\u00a0K`;
  return [`since it was put on, ${moment(now.since_ms)}`, prior, ...states, `lift ${fixed(now.lift_mm, 1)} ± ${fixed(now.lift_sigma_mm, 1)}\u00a0mm`].join("; ");
}

/**
 * The curve and its band of ± σ in the drawing's units, and what its axes are.
 * @param {PotPoint[]} points
 * @returns {{band: string, line: string, label: string}}
 */
export function outline(points) {
  if (points.length < 2) return { band: "", line: "", label: "" };
  const first_ms = points[0].at_ms;
  const span_ms = Math.max(1, points[points.length - 1].at_ms - first_ms);
  const least = Math.min(0, ...points.map((p) => p.rise_k));
  const most = Math.max(least + MIN_K, ...points.map((p) => p.rise_k + p.sigma_k));
  const at = (/** @type {PotPoint} */ p, /** @type {number} */ k) => {
    const inside = Math.min(most, Math.max(least, k));
    return `${((WIDTH * (p.at_ms - first_ms)) / span_ms).toFixed(1)},${((HEIGHT * (most - inside)) / (most - least)).toFixed(1)}`;
  };
  const upper = points.map((p) => at(p, p.rise_k + p.sigma_k));
  const lower = points.map((p) => at(p, p.rise_k - p.sigma_k)).reverse();
  return {
    band: [...upper, ...lower].join(" "),
    line: points.map((p) => at(p, p.rise_k)).join(" "),
    label: `${fixed(least, 0)} to ${fixed(most, 0)}\u00a0K over ${fixed(span_ms / 60000, 1)}\u00a0min, band ± σ`,
  };
}

/** A rise with its sign. @param {number} rise_k */
const signed = (rise_k) => `${rise_k >= 0 ? "+" : "−"}${fixed(Math.abs(rise_k), 0)}`;
