// @ts-check
/**
 * A device's past in columns: read from the daemon's store, grown by the live stream on the same grid, bounded.
 *
 * Columns in which nothing is known have null. Silence longer than a column is a gap: a column of nulls, so that no
 * line is drawn across it.
 */

/** Most columns that are kept. */
export const CAPACITY = 6000;

/** Most results of the network that are kept. */
const MAX_RESULTS = 4000;

const QUANTITIES = /** @type {const} */ (["power_w", "r_ohm", "l_h", "f_sw_hz"]);

/**
 * @typedef {{min: (number | null)[], mean: (number | null)[], max: (number | null)[]}} Envelope
 * @typedef {{at_s: number[], r_ohm: (number | null)[], l_h: (number | null)[], r_sigma: (number | null)[],
 *   l_sigma: (number | null)[], pass: boolean[]}} Results   sigma in percent
 */

export class TrendColumns {
  constructor() {
    /** Width of the store's columns, and of those of the live stream. */
    this.step_ms = 1000;
    this.live_ms = 1000;
    /** @type {number[]} begin of each column, seconds since 1970 */
    this.at_s = [];
    /** @type {Record<typeof QUANTITIES[number], Envelope>} */
    this.quantities = { power_w: envelope(), r_ohm: envelope(), l_h: envelope(), f_sw_hz: envelope() };
    /** @type {(number | null)[]} */
    this.phase_deg = [];
    /** @type {(number | null)[]} */
    this.resonance_hz = [];
    /** @type {(number | null)[]} */
    this.asked_w = [];
    /** Half-cycles that the means of the last column stand for. */
    this.weight = 0;
    /** @type {Results} */
    this.results = { at_s: [], r_ohm: [], l_h: [], r_sigma: [], l_sigma: [], pass: [] };
  }

  /** Forgets everything. */
  clear() {
    for (const list of this.#lists()) list.length = 0;
    for (const list of Object.values(this.results)) list.length = 0;
    this.weight = 0;
  }

  /**
   * What the store has.
   * @param {any} history
   * @param {number} [live_ms] width of columns of the live stream, where that is less: the store's are a second at least
   */
  load(history, live_ms = Infinity) {
    this.clear();
    this.step_ms = Math.max(1, history.step_ms);
    this.live_ms = Math.min(this.step_ms, live_ms);
    for (let k = 0; k < history.at_ms.length; k += 1) {
      this.#gapBefore(history.at_ms[k]);
      this.at_s.push(history.at_ms[k] / 1000);
      for (const quantity of QUANTITIES) {
        const from = history[quantity];
        const to = this.quantities[quantity];
        to.min.push(from.min[k] ?? null);
        to.mean.push(from.mean[k] ?? null);
        to.max.push(from.max[k] ?? null);
      }
      this.phase_deg.push(history.phase_deg[k] ?? null);
      this.resonance_hz.push(history.resonance_hz[k] ?? null);
      this.asked_w.push(history.asked_w[k] ?? null);
      this.weight = history.half_cycles[k] ?? 1;
    }
    const results = history.results;
    this.results = {
      at_s: results.at_ms.map((/** @type {number} */ at_ms) => at_ms / 1000),
      r_ohm: [...results.r_ohm], l_h: [...results.l_h], r_sigma: [...results.sigma_r_pct], l_sigma: [...results.sigma_l_pct],
      pass: [...results.pass],
    };
  }

  /**
   * An interval of the live stream.
   * @param {number} at_ms
   * @param {import("../telemetry.js").DeviceTelemetry} one
   */
  append(at_ms, one) {
    if (one.half_cycles === 0 || !one.last) return;
    const last_ms = this.at_s.length ? this.at_s[this.at_s.length - 1] * 1000 : null;
    const origin_ms = last_ms ?? at_ms;
    const steps = Math.floor((at_ms - origin_ms) / this.live_ms + 1e-6);
    if (last_ms === null || steps >= 1) this.#begin(origin_ms + steps * this.live_ms);
    this.#merge(one);
    if (this.at_s.length > CAPACITY * 1.1) this.dropBefore(this.at_s[this.at_s.length - CAPACITY]);
  }

  /**
   * A result of the network.
   * @param {{at_ms: number, r_ohm: number, l_h: number, pass: boolean, sigma_r_pct?: number | null, sigma_l_pct?: number | null}} result
   */
  appendResult(result) {
    const { results } = this;
    const at_s = result.at_ms / 1000;
    if (results.at_s.length && at_s <= results.at_s[results.at_s.length - 1]) return;
    results.at_s.push(at_s);
    results.r_ohm.push(result.r_ohm);
    results.l_h.push(result.l_h);
    results.r_sigma.push(result.sigma_r_pct ?? null);
    results.l_sigma.push(result.sigma_l_pct ?? null);
    results.pass.push(result.pass);
    if (results.at_s.length > MAX_RESULTS * 1.1) {
      const drop = results.at_s.length - MAX_RESULTS;
      for (const list of Object.values(results)) list.splice(0, drop);
    }
  }

  /**
   * Forgets what is older.
   * @param {number} from_s
   */
  dropBefore(from_s) {
    let drop = 0;
    while (drop < this.at_s.length && this.at_s[drop] < from_s) drop += 1;
    if (drop === 0) return;
    for (const list of this.#lists()) list.splice(0, drop);
  }

  /** Begins a column; after a silence a column of nulls before it. @param {number} begin_ms */
  #begin(begin_ms) {
    this.#gapBefore(begin_ms);
    for (const list of this.#lists()) list.push(/** @type {any} */ (null));
    this.at_s[this.at_s.length - 1] = begin_ms / 1000;
    this.weight = 0;
  }

  /** @param {number} begin_ms */
  #gapBefore(begin_ms) {
    if (this.at_s.length === 0) return;
    const last_ms = this.at_s[this.at_s.length - 1] * 1000;
    // Telemetry is not on the grid of the columns: one empty column is no silence.
    if (begin_ms - last_ms <= Math.max(2.5 * this.step_ms, 1500)) return;
    for (const list of this.#lists()) list.push(/** @type {any} */ (null));
    this.at_s[this.at_s.length - 1] = (last_ms + this.step_ms) / 1000;
  }

  /** @param {import("../telemetry.js").DeviceTelemetry} one */
  #merge(one) {
    const k = this.at_s.length - 1;
    const weight = Math.max(1, one.half_cycles);
    const share = weight / (this.weight + weight);
    for (const quantity of QUANTITIES) {
      const range = one[quantity];
      const value = one.last[quantity];
      // A number that was none comes as null.
      const known = range && Number.isFinite(range[0]) && Number.isFinite(range[1]) && Number.isFinite(value) && (quantity === "power_w" || one.last.f_sw_hz > 0);
      if (!known) continue;
      const { min, mean, max } = this.quantities[quantity];
      const before = mean[k];
      min[k] = Math.min(min[k] ?? Infinity, range[0]);
      max[k] = Math.max(max[k] ?? -Infinity, range[1]);
      mean[k] = before === null ? value : before + (value - before) * share;
    }
    this.phase_deg[k] = one.phase_deg ?? this.phase_deg[k];
    this.resonance_hz[k] = one.resonance_hz ?? this.resonance_hz[k];
    this.asked_w[k] = one.last.asked_w;
    this.weight += weight;
  }

  /** @returns {any[][]} every list that has an entry a column */
  #lists() {
    const envelopes = Object.values(this.quantities).flatMap((one) => [one.min, one.mean, one.max]);
    return [this.at_s, ...envelopes, this.phase_deg, this.resonance_hz, this.asked_w];
  }
}

/** @returns {Envelope} */
function envelope() {
  return { min: [], mean: [], max: [] };
}
