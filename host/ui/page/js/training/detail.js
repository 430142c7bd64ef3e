// @ts-check
/** One fit: its numbers, the gate's verdict and remarks, loss and change of each step. */

import { append, h, setText } from "../dom.js";
import { dateTime, fixed, NOTHING, si, significant } from "../format.js";
import { percent } from "../map/words.js";
import { Plot } from "../plot.js";
import { aboveZero, decades } from "./fits.js";

/** @typedef {import("./fits.js").Fit} Fit */

export class Detail {
  /** @param {import("../context.js").Context} context */
  constructor(context) {
    /** @type {Fit | undefined} */
    this.shown = undefined;
    this.title = h("h2", null);
    this.verdict = h("p", { class: "training-verdict" });
    this.facts = h("dl", { class: "training-facts" });
    this.remarks = h("ul", { class: "training-remarks" });
    this.noSteps = h("p", { class: "quiet" });
    this.lossBox = h("div", { class: "training-plot" });
    this.element = h("section", { class: "training-detail", "aria-label": "The chosen fit" });
    append(this.element, [this.title, this.verdict, this.facts, this.remarks, this.noSteps, this.lossBox]);
    this.lossPlot = new Plot(this.lossBox, {
      theme: context.theme,
      announce: context.announce,
      device: () => context.device,
      title: "Loss and change per step",
      name: "training-steps",
      x: { label: "step of the optimiser", unit: "1" },
      axes: [
        { key: "loss", label: "loss", unit: "1", log: true, range: decades },
        { key: "change", label: "largest change of R and L", unit: "%", factor: 100, side: "right", log: true, range: decades },
      ],
      series: [
        { label: "loss", axis: "loss", colour: "s1", marker: "circle", digits: 4 },
        { label: "change", axis: "change", colour: "s2", dash: [6, 4], marker: "square", digits: 4 },
      ],
      height: () => 220,
      table: () => ({
        remarks: [`window ${this.shown?.seq} of boot ${this.shown?.boot}`],
        head: ["step", "loss", "change"],
        rows: (this.shown?.steps ?? []).map((step) => [step.step, step.loss, step.change]),
      }),
    });
  }

  /** Ends it. */
  destroy() {
    this.lossPlot.destroy();
  }

  /** @param {Fit} fit */
  show(fit) {
    if (this.shown === fit) return;
    this.shown = fit;
    setText(this.title, `Window ${fit.seq}, ${dateTime(fit.at_ms)}`);
    this.verdict.className = `training-verdict ${fit.pass ? "good" : "bad"}`;
    this.verdict.replaceChildren(verdictSign(fit), fit.pass ? "passed the gate" : `refused: ${fit.why || "no reason was given"}`);
    this.facts.replaceChildren(...facts(fit).map(([name, text]) => h("div", null, h("dt", null, name), h("dd", null, text))));
    this.remarks.replaceChildren(...fit.remarks.map(remarkLine));
    const plain = fit.steps.length === 0;
    this.lossBox.hidden = plain;
    this.noSteps.hidden = !plain;
    setText(this.noSteps, plain ? "Its steps and remarks are not known: it was fitted before the daemon was started." : "");
    if (plain) return;
    const steps = fit.steps;
    this.lossPlot.set([steps.map((s) => s.step), steps.map((s) => aboveZero(s.loss)), steps.map((s) => aboveZero(s.change))], fit.at_ms);
  }
}

/** @param {number | null} value */
export const pct = (value) => (value === null ? NOTHING : `${significant(value, 2)}\u00a0%`);

/** @param {Fit} fit */
export const verdictSign = (fit) => h("span", { class: fit.pass ? "training-sign good" : "training-sign bad", "aria-hidden": "true" }, fit.pass ? "✓ " : "✕ ");

/** @param {Fit} fit @returns {[string, string][]} */
function facts(fit) {
  const against = (/** @type {number | null} */ error, /** @type {number | null} */ sigma) =>
    error === null ? "no truth: not simulated here" : `${percent(error)}${sigma ? `, ${fixed(Math.abs(error) / sigma, 1)}\u00a0σ` : ""}`;
  return [
    ["f_sw", si(fit.f_sw_hz, "Hz", 5)],
    ["R, mean", `${si(fit.r_ohm, "Ω", 5)} ± ${pct(fit.sigma_r_pct)}`],
    ["L, mean", `${si(fit.l_h, "H", 5)} ± ${pct(fit.sigma_l_pct)}`],
    ["Error of R", against(fit.r_error_pct, fit.sigma_r_pct)],
    ["Error of L", against(fit.l_error_pct, fit.sigma_l_pct)],
    ["Steps", String(fit.iterations)],
    ["Took", fit.seconds === null ? NOTHING : si(fit.seconds, "s", 3)],
    ["Lookup", fit.changed_lookup ? "changed by it" : "not changed"],
    ["Boot", String(fit.boot)],
  ];
}

/** @param {{code: string, severity: string, text: string}} remark */
function remarkLine(remark) {
  const sign = { error: "✕", warning: "▲", info: "i" }[remark.severity] ?? "·";
  const kind = { error: "bad", warning: "warn" }[remark.severity] ?? "quiet";
  return h("li", null, h("span", { class: `training-severity ${kind}` }, `${sign} ${remark.severity}`), h("code", null, remark.code), h("span", null, remark.text));
}
