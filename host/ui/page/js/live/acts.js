// @ts-check
/** What else can be asked of a device: sweep, clear fault, reset of the lookup. Each says what it will do. */

import { h, setText } from "../dom.js";
import { actOrAsk, heatOrAsk } from "./power.js";

/** Powers of a sweep as shares of the rated one: what `ihd trainer` goes through in its demonstration, evenly. */
const SWEEP_SHARES = [0.2, 0.4, 0.6, 0.8];

export class Acts {
  /**
   * @param {HTMLElement} root
   * @param {import("../context.js").Context} context
   */
  constructor(root, context) {
    this.context = context;
    const button = (/** @type {string} */ label, /** @type {string} */ testid, /** @type {() => void} */ click) =>
      h("button", { type: "button", data: { testid }, on: { click } }, label);
    this.sweepButton = button("Sweep …", "sweep", () => this.#sweep());
    this.clearButton = button("Clear fault …", "clear-fault", () => this.#clearFault());
    this.resetButton = button("Reset lookup …", "lookup-reset", () => this.#reset());
    this.says = h("p", { class: "quiet", role: "status", data: { testid: "act-says" } });
    root.append(h("section", { class: "panel live-acts", "aria-label": "Further commands" },
      h("div", { class: "acts" }, this.sweepButton, this.clearButton, this.resetButton), this.says));
    this.stops = [
      context.stream.frame("devices", () => this.show()),
      context.leases.on(() => {
        const { phase, why } = context.leases.state(context.device);
        if (phase === "none" && why) setText(this.says, why);
      }),
    ];
    this.show();
  }

  /** Ends it. */
  stop() {
    for (const stop of this.stops) stop();
  }

  show() {
    const { session, fleet, device } = this.context;
    const report = fleet.reports.get(device);
    const may = session.role !== "read" && !!report && report.state !== "searching" && report.state !== "incompatible";
    this.sweepButton.disabled = !may;
    this.resetButton.disabled = !may;
    this.clearButton.disabled = !may || !report.live?.fault;
    for (const one of [this.sweepButton, this.clearButton, this.resetButton]) {
      one.title = session.role === "read" ? "your token may only look" : one === this.clearButton && !report?.live?.fault ? "there is no fault" : "";
    }
  }

  async #sweep() {
    const { hob, device, ask } = this.context;
    const powers = SWEEP_SHARES.map((share) => Math.round((share * hob.rated_power_w) / 50) * 50);
    const input = h("input", { type: "text", inputmode: "numeric", id: "sweep-powers", value: powers.join(", ") });
    const answer = await ask({
      title: `Sweep ${device}?`,
      text: `Heats ${device} with one power after the other, some windows of each, so that the lookup learns more of the map; then it is off. It ends when this page is closed, by Off, or by a fault.`,
      input: h("p", {}, h("label", { for: "sweep-powers" }, `Powers / W, rated ${hob.rated_power_w}, with commas`), h("br"), input),
      answers: [{ label: "Heat and sweep", value: "sweep", danger: true }],
    });
    if (answer !== "sweep") return;
    const powers_w = powersOf(input.value, hob.requested_power_max_w);
    if (powers_w === null) {
      setText(this.says, `No sweep: powers are whole numbers of watt up to ${hob.requested_power_max_w}, with commas between them.`);
      return;
    }
    await this.#carryOut(() => heatOrAsk(this.context, { command: "sweep", powers_w }));
  }

  async #clearFault() {
    const { device, ask, fleet } = this.context;
    const live = fleet.live(device);
    const answer = await ask({
      title: `Clear the fault of ${device}?`,
      text: `Fault ${live?.fault ?? "?"}: ${live?.fault_text ?? "not known any more"}. Mend its cause first. ${device} leaves the safe state; if power is still asked of it, it may heat again at once. A hob that is locked out stays so until it is switched off and on.`,
      answers: [{ label: "Clear the fault", value: "clear", danger: true }],
    });
    if (answer === "clear") await this.#carryOut(() => actOrAsk(this.context, { command: "clear-fault" }));
  }

  async #reset() {
    const { device, ask } = this.context;
    const answer = await ask({
      title: `Reset the lookup of ${device}?`,
      text: `${device} goes back to the built-in prior, and what the daemon has learned of this device is forgotten: it learns anew. Earlier versions stay in the store, and can be offered again in the map's view. Power control may be slower until then, and is no less safe.`,
      answers: [{ label: "Forget and reset", value: "reset", danger: true }],
    });
    if (answer === "reset") await this.#carryOut(() => actOrAsk(this.context, { command: "lookup-reset" }));
  }

  /** @param {() => Promise<{text: string} | null>} act */
  async #carryOut(act) {
    setText(this.says, "…");
    try {
      const done = await act();
      setText(this.says, done ? done.text : "");
      this.says.classList.remove("bad");
    } catch (why) {
      setText(this.says, why instanceof Error ? why.message : String(why));
      this.says.classList.add("bad");
    }
  }
}

/**
 * @param {string} text
 * @param {number} most_w
 * @returns {number[] | null} null where it is no list of powers
 */
export function powersOf(text, most_w) {
  const powers = text.split(/[,;\s]+/).filter(Boolean).map(Number);
  const good = powers.length >= 1 && powers.every((w) => Number.isInteger(w) && w > 0 && w <= most_w);
  return good ? powers : null;
}
