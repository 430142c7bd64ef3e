// @ts-check
/** What a scope would measure between the ends of the view. */

import { h, setAttribute, setText } from "../dom.js";
import { fixed, NOTHING, si } from "../format.js";

/** @type {[string, string, (value: number) => string][]} */
const ROWS = [
  ["v_rms_v", "V rms", (x) => si(x, "V", 4)], ["v_peak_v", "V peak", (x) => si(x, "V", 4)],
  ["i_rms_a", "I rms", (x) => si(x, "A", 4)], ["i_peak_a", "I peak", (x) => si(x, "A", 4)],
  ["power_w", "P", (x) => `${fixed(x, 1)}\u00a0W`], ["power_factor", "Power factor", (x) => fixed(x, 4)],
  ["phase_deg", "Phase v to i", (x) => `${fixed(x, 2)}°`],
  ["thd_v_pct", "THD v", (x) => `${fixed(x, 2)}\u00a0%`], ["thd_i_pct", "THD i", (x) => `${fixed(x, 2)}\u00a0%`],
];

export class MeasuredTable {
  constructor() {
    this.cells = ROWS.map(([key]) => h("td", { class: "number", data: { testid: `measured-${key}` } }, NOTHING));
    this.over = h("p", { class: "quiet" });
    this.root = h("div", { class: "measured" },
      h("table", {}, h("caption", {}, "Measured in the view"),
        h("tbody", {}, ROWS.map(([, label], i) => h("tr", {}, h("th", { scope: "row" }, label), this.cells[i])))),
      this.over);
  }

  /** @param {any} scope */
  show(scope) {
    const { measured } = scope;
    ROWS.forEach(([key, , text], i) => {
      const value = measured[key];
      const known = typeof value === "number";
      setText(this.cells[i], known ? text(value) : NOTHING);
      setAttribute(this.cells[i], "data-value", known ? String(value) : "");
    });
    setText(this.over, measured.periods
      ? `over ${measured.periods} whole switching ${measured.periods === 1 ? "period" : "periods"}, ${si(scope.to_s - scope.from_s, "s", 3)}`
      : "the view holds no whole switching period");
  }
}
