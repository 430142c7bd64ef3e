// @ts-check
/** One device as on an oscilloscope: numbers, power, the pot's temperature, the last window, the past. */

import { h } from "../dom.js";
import { Acts } from "../live/acts.js";
import { Numbers } from "../live/numbers.js";
import { PotTemperatureView } from "../live/pot-temperature.js";
import { Power } from "../live/power.js";
import { ScopeView } from "../live/scope.js";
import { Trends } from "../live/trends.js";

/**
 * @param {HTMLElement} root
 * @param {import("../context.js").Context} context
 * @returns {{unmount: () => void}}
 */
export function mount(root, context) {
  const side = h("div", { class: "live-side" });
  const scope = h("section", { class: "live-scope panel", "aria-label": "Last window" });
  const trends = h("section", { class: "live-trends panel", "aria-label": "Minutes and hours" });
  root.append(h("h1", { class: "unseen" }, `Live: ${context.device}`), h("div", { class: "live-grid" }, side, scope, trends));
  const parts = [
    new Numbers(side, context), new Power(side, context), new PotTemperatureView(side, context), new Acts(side, context),
    new ScopeView(scope, context), new Trends(trends, context),
  ];
  return { unmount: () => parts.forEach((part) => part.stop()) };
}
