// @ts-check
/** The numbers of one cell, in a line below the map. */

import { h, setText } from "../dom.js";
import { duration, fixed, NOTHING, si } from "../format.js";
import { percent, withDeviation } from "./words.js";

const FIELDS = /** @type {[string, string][]} */ ([
  ["f", "f_sw"],
  ["i", "I, crest"],
  ["r", "R, crest"],
  ["l", "L, crest"],
  ["power", "P, mean"],
  ["observed", "Known"],
  ["confidence", "Confidence"],
  ["age", "Learned"],
  ["difference", "Difference"],
]);

export class Readout {
  constructor() {
    this.whose = h("p", { class: "map-whose quiet" });
    this.fields = Object.fromEntries(FIELDS.map(([key]) => [key, h("dd", null, NOTHING)]));
    const rows = FIELDS.map(([key, name]) => h("div", null, h("dt", null, name), this.fields[key]));
    this.element = h("div", null, this.whose, h("dl", { class: "map-readout" }, rows));
  }

  /**
   * @param {string} whose which cell it is, in words
   * @param {import("./words.js").CellNumbers} cell
   * @param {number | null} reference version that the difference is to
   */
  show(whose, cell, reference) {
    setText(this.whose, whose);
    const to = reference === null ? "" : ` to ${reference}`;
    /** @type {Record<string, string>} */
    const said = {
      f: si(cell.f_sw_hz, "Hz", 4),
      i: `${fixed(cell.i_a, 2)}\u00a0A`,
      r: withDeviation(si(cell.r_ohm, "Ω", 4), cell.sigma_r_pct),
      l: withDeviation(si(cell.l_h, "H", 4), cell.sigma_l_pct),
      power: si(cell.power_w, "W", 3),
      observed: cell.observed ? "yes" : "no",
      confidence: fixed(cell.confidence, 2),
      age: cell.age_s === null ? "never" : duration(cell.age_s),
      difference: `R ${percent(cell.r_difference_pct)}, L ${percent(cell.l_difference_pct)}${to}`,
    };
    for (const [key, text] of Object.entries(said)) setText(this.fields[key], text);
  }
}
