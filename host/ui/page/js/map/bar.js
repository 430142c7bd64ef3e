// @ts-check
/** The colour bar of a heat map, and the legend of what is drawn over its cells. */

import { h, setAttribute, setText } from "../dom.js";
import { barColour } from "./picture.js";
import { tickText, title } from "./words.js";

export class Bar {
  /** @param {import("../theme.js").Theme} theme */
  constructor(theme) {
    this.theme = theme;
    this.colours = h("canvas", { width: "256", height: "1", class: "map-bar-colours" });
    this.ticks = h("div", { class: "map-bar-ticks", "aria-hidden": "true" });
    this.title = h("span", { class: "map-bar-title" });
    this.element = h("div", { class: "map-bar", role: "img" }, this.title, h("div", { class: "map-bar-scale" }, this.colours, this.ticks));
  }

  /** @param {import("../heatmap.js").Picture} picture */
  show(picture) {
    const { scale, quantity } = picture;
    const context = this.colours.getContext("2d");
    for (let k = 0; k < 256; k++) {
      context.fillStyle = barColour(picture, k / 255, this.theme.dark);
      context.fillRect(k, 0, 1, 1);
    }
    const diverging = quantity.scale === "diverging";
    setText(this.title, title(quantity, scale));
    this.element.hidden = scale.empty;
    const ends = [scale.low, scale.high].map((end) => tickText(quantity, end, scale));
    setAttribute(this.element, "aria-label", `Colours from ${ends[0]} to ${ends[1]}: ${title(quantity, scale)}`);
    this.ticks.replaceChildren(
      ...scale.ticks.map((tick) => {
        const label = h("span", null, tickText(quantity, tick, scale));
        label.style.left = `${100 * (diverging ? (scale.place(tick) + 1) / 2 : scale.place(tick))}%`;
        return label;
      }),
    );
  }
}

/** What is drawn over the cells. */
export function legend() {
  const entry = (/** @type {string} */ kind, /** @type {string} */ text) =>
    h("li", null, h("span", { class: `map-key ${kind}`, "aria-hidden": "true" }), text);
  return h(
    "ul",
    { class: "map-legend" },
    entry("map-key-unseen", "not known: the prior, or a guess"),
    entry("map-key-limit", "limits of f_sw and of the current"),
    entry("map-key-margin", "resonance margin by this map"),
    entry("map-key-now", "working point, its last seconds"),
  );
}
