// @ts-check
/** Rows of the fleet's tables: how old they are, which of them are shown, in which order. */

import { potText } from "../device-words.js";
import { duration, words } from "../format.js";

/** Who has not been heard of for so long is silent, in milliseconds. */
export const SILENT_MS = 30_000;

/** Clocks of two machines differ by this without being wrong, in milliseconds. */
const CLOCKS_MS = 5_000;

/**
 * As GET /api/v1/fleet tells it.
 * @typedef {{name: string, version: string, threads: number, busy: number, done: number, failed: number, last_seen_ms: number}} Worker
 * @typedef {{name: string, version: string, outbox: number, trusts_fleet: boolean, alarms: string[], last_seen_ms: number}} Edge
 * @typedef {{due: number, sent: number, answered: number, learned_here: number, no_samples: number, dead: number, not_for_fleet: number}} States
 * @typedef {{name: string, edge: string, state: string, pot: string, build: string, protocol: [number, number],
 *   lookup_version: number, outdated: boolean, last_seen_ms: number}} Device
 * @typedef {{server: string, edge: string, connected: boolean, why: string, at_ms: number, outbox: number, states: States, alarms: string[], windows: number,
 *   results: number, backlog: number, dead: number, workers: Worker[], edges: Edge[], devices: Device[]}} Report
 * @typedef {{text: string, outdated: boolean, silent: boolean}} Filter
 */

/**
 * @param {{last_seen_ms: number}} row
 * @param {number} now_ms since 1970, the daemon's clock
 * @returns {boolean}
 */
export function isSilent(row, now_ms) {
  return now_ms - row.last_seen_ms > SILENT_MS;
}

/**
 * When somebody was heard of last, in words: silence has a word of its own.
 * @param {number} at_ms since 1970; 0 where he never was
 * @param {number} now_ms the same
 * @returns {string}
 */
export function seenText(at_ms, now_ms) {
  if (at_ms <= 0) return "never";
  const age_ms = now_ms - at_ms;
  if (age_ms < -CLOCKS_MS) return `in ${duration(Math.round(-age_ms / 1000))}: its clock is wrong`;
  const age = duration(Math.max(0, Math.floor(age_ms / 1000)));
  if (age_ms > SILENT_MS) return `silent for ${age}`;
  return age_ms < 2000 ? "now" : `${age} ago`;
}

/**
 * @param {[number, number]} protocol
 * @returns {string} empty where it was never told
 */
export function protocolText([major, minor]) {
  return major === 0 && minor === 0 ? "" : `${major}.${minor}`;
}

/**
 * Devices that hold every word of the text somewhere, and are outdated or silent where that is asked for.
 * @param {Device[]} devices
 * @param {Filter} filter
 * @param {number} now_ms
 * @returns {Device[]}
 */
export function filtered(devices, filter, now_ms) {
  const wanted = filter.text.toLowerCase().split(/\s+/).filter(Boolean);
  return devices.filter((device) => {
    if (filter.outdated && !device.outdated) return false;
    if (filter.silent && !isSilent(device, now_ms)) return false;
    if (wanted.length === 0) return true;
    const { name, edge, state, pot, build, protocol } = device;
    const text = [name, edge, state, words(state), pot, potText(pot), build, protocolText(protocol)].join("\n").toLowerCase();
    return wanted.every((word) => text.includes(word));
  });
}

/** `hob-2` before `hob-10`. */
const collator = new Intl.Collator("en", { numeric: true, sensitivity: "base" });

/**
 * @template {{name: string}} R
 * @param {R[]} rows
 * @param {(row: R) => string | number} by
 * @param {boolean} down the largest first
 * @returns {R[]} another list; equals by name, upwards
 */
export function sorted(rows, by, down) {
  const compare = (/** @type {string | number} */ a, /** @type {string | number} */ b) =>
    typeof a === "number" && typeof b === "number" ? a - b : collator.compare(String(a), String(b));
  const keyed = rows.map((row) => ({ row, key: by(row) }));
  keyed.sort((a, b) => (down ? -1 : 1) * compare(a.key, b.key) || collator.compare(a.row.name, b.row.name));
  return keyed.map(({ row }) => row);
}

/** Rows beyond each end of what is seen that are there nevertheless: a scroll does not show a hole. */
const BEYOND = 8;

/**
 * The rows that have to be there.
 * @param {number} top how far is scrolled, in pixel
 * @param {number} height of what is seen, in pixel
 * @param {number} row height of a row, in pixel
 * @param {number} n rows
 * @returns {[number, number]} the first, and the one after the last
 */
export function inView(top, height, row, n) {
  const first = Math.min(Math.max(0, Math.floor(top / row) - BEYOND), n);
  const end = Math.min(n, Math.ceil((top + height) / row) + BEYOND);
  return [first, Math.max(first, end)];
}

/**
 * How the fleet's server is reached, in words.
 * @param {Report} report
 * @returns {string}
 */
export function serverText(report) {
  const server = report.server || "a server without a name";
  // One that answers may still have a say: a key that may not look at everything.
  return `${report.connected ? "● connected to" : "✖ not connected to"} ${server}${report.why ? `: ${report.why}` : ""}`;
}

/**
 * How old the numbers are.
 * @param {Report} report
 * @param {number} now_ms
 * @returns {string}
 */
export function ageText(report, now_ms) {
  if (report.at_ms <= 0) return "nothing is known of the fleet yet";
  const age_s = Math.max(0, Math.floor((now_ms - report.at_ms) / 1000));
  return `the numbers are ${age_s < 1 ? "of now" : `${duration(age_s)} old`}`;
}

/**
 * @param {Device[]} devices
 * @param {number} shown of them
 * @param {number} now_ms
 * @returns {string}
 */
export function devicesText(devices, shown, now_ms) {
  if (devices.length === 0) return "No edge has told of a device yet.";
  const outdated = devices.filter((device) => device.outdated).length;
  const silent = devices.filter((device) => isSilent(device, now_ms)).length;
  const all = `${devices.length} ${devices.length === 1 ? "device" : "devices"}: ${outdated} outdated, ${silent} silent`;
  return shown === devices.length ? all : `${shown} of ${all}`;
}
