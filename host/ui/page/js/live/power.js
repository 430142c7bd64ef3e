// @ts-check
/** Power of the chosen device, as a lease of this page. */

import { h, setAttribute, setText } from "../dom.js";
import { duration } from "../format.js";
import { steady_ms } from "../lease-machine.js";

/** A slider that is moved with keys sends once it rests, in milliseconds. */
const REST_MS = 300;

export class Power {
  /**
   * @param {HTMLElement} root
   * @param {import("../context.js").Context} context
   */
  constructor(root, context) {
    this.context = context;
    const most = context.hob.rated_power_w;
    const { phase, power_w, asked_w = power_w } = context.leases.state(context.device);
    const power = phase === "held" || phase === "late" ? asked_w : Math.round(most / 2 / 50) * 50;
    const input = { min: "0", step: "10" };
    this.input = h("input", { ...input, max: String(context.hob.requested_power_max_w), id: "power", type: "number", inputmode: "numeric", "aria-describedby": "power-says", data: { testid: "power-input" }, value: String(power),
      on: { input: () => this.#copy(this.input, this.slider), keydown: (/** @type {KeyboardEvent} */ event) => event.key === "Enter" && !event.repeat && this.#set() } });
    this.slider = h("input", { ...input, max: String(most), step: "50", type: "range", "aria-label": "Power in watt", data: { testid: "power-slider" }, value: this.input.value,
      on: { input: () => this.#copy(this.slider, this.input), change: () => this.#rest() } });
    this.button = h("button", { type: "button", class: "strong", data: { testid: "power-set" }, on: { click: () => this.#set() } }, "Set");
    this.says = h("p", { id: "power-says", class: "quiet", data: { testid: "power-says" } });
    this.name = h("input", { id: "own-name", type: "text", maxlength: "32", autocomplete: "nickname", value: context.api.ownName(), title: "told to others, and kept in the journal; changes with the next power that is set", on: { change: () => context.api.setOwnName(this.name.value) } });
    this.problem = h("p", { class: "bad", role: "alert", data: { testid: "power-problem" } });
    root.append(h("section", { class: "panel live-power", "aria-label": "Power" },
      h("div", { class: "power-row" }, h("label", { for: "power" }, "Power / W"), this.input, this.button),
      this.slider,
      h("div", { class: "power-scale quiet", "aria-hidden": "true" }, h("span", {}, "0"), h("span", {}, `rated ${most} W`)),
      this.says, this.problem,
      h("div", { class: "power-name quiet" }, h("label", { for: "own-name" }, "Commands as"), this.name)));
    this.stops = [context.leases.on(() => this.show()), context.stream.frame("devices", () => this.show())];
    this.timer = setInterval(() => this.show(), 1000);
    this.show();
  }

  /** Ends it. Power that was set goes on: it belongs to the page, not to the view. */
  stop() {
    clearInterval(this.timer);
    clearTimeout(this.resting);
    for (const stop of this.stops) stop();
  }

  show() {
    const { leases, device, session, fleet } = this.context;
    const state = leases.state(device);
    const report = fleet.reports.get(device);
    const why = session.role === "read" ? "Your token may only look." : reasonAgainst(report);
    for (const element of [this.input, this.slider, this.button]) element.disabled = why !== "";
    setText(this.button, state.phase === "taking" ? "Setting …" : "Set");
    setAttribute(this.says, "data-value", state.phase);
    setText(this.says, why || this.#saysOf(state, report));
  }

  /**
   * @param {import("../lease-machine.js").LeaseState} state
   * @param {any} report
   */
  #saysOf(state, report) {
    const { device, api } = this.context;
    if (state.phase === "held" && this.context.leases.sweeping.has(device)) return `This page sweeps ${device}, up to ${state.power_w} W. It goes off when the sweep is done or the page is closed.`;
    if (state.phase === "held") {
      const most = (state.asked_w ?? 0) > state.power_w ? `, the most it gives (${state.asked_w} W asked)` : "";
      return `This page heats ${device} with ${state.power_w} W${most}. It goes off when the page is closed.`;
    }
    if (state.phase === "late") {
      return `Not renewed for ${duration((steady_ms() - state.renewed_ms) / 1000)}: ${state.why}.`;
    }
    if (state.phase === "taking") return "Takes the lease …";
    const other = report?.lease && report.lease.holder !== api.holder() ? `${report.lease.holder} commands it now; you will be asked before it is taken over. ` : "";
    return `${other}Set heats ${device} for as long as this page is open; closed or crashed, it is off within 10 s.`;
  }

  /**
   * @param {any} from
   * @param {any} to
   */
  #copy(from, to) {
    to.value = from.value;
  }

  /** The slider came to rest: a page that heats already follows it. */
  #rest() {
    clearTimeout(this.resting);
    if (!this.#holds()) return;
    // Off may come while it rests: what is not held any more is not heated.
    this.resting = setTimeout(() => this.#holds() && this.#set(), REST_MS);
  }

  #holds() {
    return this.context.leases.state(this.context.device).phase === "held";
  }

  /** @type {any} */
  resting = 0;

  async #set() {
    clearTimeout(this.resting);
    const { device, off, hob, announce, leases, api } = this.context;
    if (leases.state(device).phase === "taking") return;
    if (leases.heated().length === 0) api.useOwnName();
    const power_w = Number(this.input.value);
    setText(this.problem, "");
    if (this.input.value.trim() === "" || !Number.isInteger(power_w) || power_w < 0 || power_w > hob.requested_power_max_w) {
      setText(this.problem, `Power is a whole number of watt from 0 to ${hob.requested_power_max_w}.`);
      return;
    }
    if (power_w === 0) {
      off.only(device);
      return;
    }
    try {
      const done = await heatOrAsk(this.context, { command: "power", power_w });
      if (done) announce(done.text);
    } catch (why) {
      setText(this.problem, why instanceof Error ? why.message : String(why));
    }
    this.show();
  }
}

/** @param {any} report */
function reasonAgainst(report) {
  if (!report) return "The device is not known to the daemon.";
  if (report.state === "searching") return `Not connected: ${report.detail || "nobody answers at its address"}.`;
  if (report.state === "incompatible") return `Firmware does not fit: ${report.updates_needed || report.detail}.`;
  return "";
}

/**
 * Heats; where somebody else commands, asks whether to take it over.
 * @param {import("../context.js").Context} context
 * @param {{command: string, [field: string]: any}} body
 * @returns {Promise<{text: string} | null>} null where it was not wanted
 */
export function heatOrAsk(context, body) {
  return orAsk(context, (force) => context.leases.heat(context.device, body, force));
}

/**
 * Carries out a command that does not heat; where somebody else commands, asks whether to take it over.
 * @param {import("../context.js").Context} context
 * @param {{command: string, [field: string]: any}} body
 * @returns {Promise<{text: string, file: string | null} | null>} null where it was not wanted
 */
export function actOrAsk(context, body) {
  return orAsk(context, (force) => context.leases.act(context.device, body, force));
}

/**
 * Does it, and asks before it takes over from somebody: where the last report names him, before it is tried.
 * @template T
 * @param {import("../context.js").Context} context
 * @param {(force: boolean) => Promise<T>} act
 * @returns {Promise<T | null>}
 */
async function orAsk(context, act) {
  const lease = context.fleet.reports.get(context.device)?.lease;
  if (lease && lease.holder !== context.api.holder()) {
    return (await takeOver(context, lease.holder)) ? act(true) : null;
  }
  try {
    return await act(false);
  } catch (why) {
    const problem = /** @type {import("../api.js").ApiError} */ (why);
    if (problem.status !== 423) throw why;
    return (await takeOver(context, problem.problem.holder ?? "somebody")) ? act(true) : null;
  }
}

/**
 * @param {import("../context.js").Context} context
 * @param {string} holder
 * @returns {Promise<boolean>} whether to take it over
 */
async function takeOver(context, holder) {
  const answer = await context.ask({
    title: `Take ${context.device} over from ${holder}?`,
    text: `${holder} commands ${context.device}. Taking it over switches the hob off first and ends what ${holder} asked for; ${holder} is told by whom.`,
    answers: [{ label: "Take it over", value: "take", danger: true }],
  });
  return answer === "take";
}
