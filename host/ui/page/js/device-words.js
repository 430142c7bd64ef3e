// @ts-check
/** What a device's report says, in words. */

import { NOTHING, words } from "./format.js";

/** A mark beside each state's word: told apart without colour. @type {Record<string, string>} */
export const STATE_MARK = {
  searching: "…", connected: "·", "waiting-for-pot": "○", learning: "●", idle: "–", faulted: "✖", suspended: "‖", incompatible: "≠",
};

/**
 * The mark of a state that another machine may have made up.
 * @param {string} state
 * @returns {string}
 */
export function stateMark(state) {
  return Object.hasOwn(STATE_MARK, state) ? STATE_MARK[state] : "·";
}

/**
 * @param {string} state
 * @returns {string} class of page.css
 */
export function stateClass(state) {
  if (state === "learning") return "heat";
  if (state === "faulted" || state === "incompatible") return "bad";
  if (state === "searching" || state === "suspended" || state === "waiting-for-pot") return "warn";
  return "";
}

/** @type {Record<string, string>} */
const POTS = {
  Ferromagnetic: "a pot that can be heated", Absent: "none", Small: "too small", Unsuitable: "cannot be heated by induction",
  Unknown: "not checked yet",
};

/**
 * @param {string} pot word of the API
 * @returns {string}
 */
export function potText(pot) {
  return Object.hasOwn(POTS, pot) ? POTS[pot] : words(pot);
}

/** @type {Record<string, string>} */
const LIMITS = {
  None: "", Frequency: "an end of the frequency range", Current: "the coil current", CoilVoltage: "the coil voltage",
  Resonance: "nearness of the resonance", SoftSwitching: "current left at turn-off",
  Boost: "the boost is over",
  KeepWarm: "keeps warm",
  SharedSupply: "the supply is shared with the other zone",
  BusVoltage: "the bus voltage",
};

/**
 * What holds the power below what was asked for.
 * @param {string} limit word of the API
 * @returns {string} empty for nothing
 */
export function limitText(limit) {
  return LIMITS[limit] ?? words(limit);
}

/**
 * @param {any} report
 * @returns {string}
 */
export function firmwareText(report) {
  const identity = report.identity;
  if (!identity) return report.updates_needed ? `does not fit: ${report.updates_needed}` : NOTHING;
  const [major, minor] = identity.protocol;
  const fits = report.updates_needed ? `does not fit: ${report.updates_needed}` : "fits";
  return `${identity.build}, protocol ${major}.${minor}: ${fits}`;
}

/**
 * @param {any} report
 * @returns {string}
 */
export function lookupText(report) {
  const { on_device, pending, observed_cells } = report.lookup;
  if (on_device === null || on_device === undefined) return NOTHING;
  const name = on_device === 0 ? "built-in prior" : `version ${on_device}, ${observed_cells} of 136 cells known`;
  return pending === null || pending === undefined ? name : `${name}; version ${pending} pending`;
}

/**
 * @param {any} report
 * @param {string} own name of this page
 * @returns {string}
 */
export function holderText(report, own) {
  if (!report.lease) return "nobody";
  const who = report.lease.holder === own ? `this page (${own})` : report.lease.holder;
  return `${who}, ${report.lease.expires_in_s}\u00a0s unless renewed`;
}
