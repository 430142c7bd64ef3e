// @ts-check
/** What of the map is shown: quantity, version, and the version that differences are to. */

import { fill } from "../choice.js";
import { h } from "../dom.js";
import { QUANTITIES } from "./values.js";

/** @param {number} version */
const nameOf = (version) => (version === 0 ? "0, built in" : `version ${version}`);

export class Tools {
  /**
   * @param {{quantity: (id: string) => void, version: (version: number | null) => void, reference: (version: number) => void,
   *   save: (kind: "CSV" | "PNG") => void}} does a version of null is that which the device uses
   */
  constructor(does) {
    this.quantity = h(
      "select",
      { on: { change: () => does.quantity(this.quantity.value) } },
      QUANTITIES.map((q) => h("option", { value: q.id }, q.name)),
    );
    this.version = h("select", { on: { change: () => does.version(this.version.value === "own" ? null : Number(this.version.value)) } });
    this.reference = h("select", { on: { change: () => does.reference(Number(this.reference.value)) } });
    const label = (/** @type {string} */ name, /** @type {Node} */ control) => h("label", { class: "map-choice" }, h("span", null, name), control);
    const saves = /** @type {const} */ (["CSV", "PNG"]).map((kind) =>
      h("button", { type: "button", "aria-label": `Save the map as ${kind}`, on: { click: () => does.save(kind) } }, kind),
    );
    this.element = h(
      "div",
      { class: "map-tools" },
      label("Quantity", this.quantity),
      label("Map", this.version),
      label("Difference to", this.reference),
      h("span", { class: "map-saves" }, saves),
    );
  }

  /**
   * @param {number[]} versions of the store
   * @param {number | null} own version that the device uses, where it is known
   * @param {{quantity: string, version: number | null, reference: number}} chosen
   */
  show(versions, own, chosen) {
    const all = [...new Set(versions)].filter((version) => version !== 0).sort((a, b) => b - a);
    const named = [...all, 0].map((version) => /** @type {[string, string]} */ ([String(version), nameOf(version)]));
    fill(this.version, [["own", own === null ? "in use (not known: built in)" : `in use (${nameOf(own)})`], ...named]);
    fill(this.reference, named);
    this.quantity.value = chosen.quantity;
    this.version.value = chosen.version === null ? "own" : String(chosen.version);
    this.reference.value = String(chosen.reference);
  }
}
