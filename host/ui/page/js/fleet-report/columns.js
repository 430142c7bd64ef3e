// @ts-check
/** Columns of the fleet's tables: what stands in them, and what they are sorted by. */

import { potText, stateClass, stateMark } from "../device-words.js";
import { fixed, NOTHING, words } from "../format.js";
import { isSilent, protocolText, seenText } from "./rows.js";

/**
 * A column. `by`: what it is sorted by. `look`: a class of page.css, beside the words and never instead of them.
 * @template R
 * @typedef {{key: string, label: string, text: (row: R, now_ms: number) => string, by: (row: R) => string | number,
 *   number?: boolean, look?: (row: R, now_ms: number) => string}} Column
 */

/**
 * @template {{last_seen_ms: number}} R
 * @returns {Column<R>}
 */
function seen() {
  return {
    key: "seen", label: "Last seen", text: (row, now_ms) => seenText(row.last_seen_ms, now_ms), by: (row) => row.last_seen_ms,
    look: (row, now_ms) => (isSilent(row, now_ms) ? "warn" : ""),
  };
}

/**
 * @param {string} key
 * @param {string} label
 * @returns {Column<any>} a name or another text, as it is
 */
function plain(key, label) {
  return { key, label, text: (row) => row[key] || NOTHING, by: (row) => row[key] };
}

/**
 * @param {string} key
 * @param {string} label
 * @returns {Column<any>} a count
 */
function count(key, label) {
  return { key, label, text: (row) => fixed(row[key]), by: (row) => row[key], number: true };
}

/** @type {Column<import("./rows.js").Worker>[]} */
export const WORKERS = [
  plain("name", "Worker"), plain("version", "Version"), count("threads", "Threads"), count("busy", "Busy"), count("done", "Identified"),
  { ...count("failed", "Failed"), look: (row) => (row.failed > 0 ? "warn" : "") }, seen(),
];

/** @type {Column<import("./rows.js").Edge>[]} */
export const EDGES = [
  plain("name", "Edge"), plain("version", "Version"), count("outbox", "Outbox"),
  {
    key: "learns", label: "Windows", text: (row) => (row.trusts_fleet ? "left to the fleet" : "learned here"),
    by: (row) => Number(row.trusts_fleet), look: (row) => (row.trusts_fleet ? "" : "warn"),
  },
  { key: "alarms", label: "Alarms", text: (row) => row.alarms.join("; ") || NOTHING, by: (row) => row.alarms.length, look: (row) => (row.alarms.length > 0 ? "warn" : "") },
  seen(),
];

/** @type {Column<import("./rows.js").Device>[]} */
export const DEVICES = [
  plain("name", "Device"), plain("edge", "Edge"),
  { key: "state", label: "State", text: (row) => (row.state ? `${stateMark(row.state)} ${words(row.state)}` : NOTHING), by: (row) => row.state, look: (row) => stateClass(row.state) },
  { key: "pot", label: "Pot", text: (row) => (row.pot ? potText(row.pot) : NOTHING), by: (row) => row.pot },
  {
    key: "build", label: "Firmware", text: (row) => `${row.outdated ? "▲ outdated: " : ""}${row.build || NOTHING}`, by: (row) => row.build,
    look: (row) => (row.outdated ? "warn" : ""),
  },
  {
    key: "protocol", label: "Protocol", text: (row) => protocolText(row.protocol) || NOTHING,
    by: (row) => row.protocol[0] * 65536 + row.protocol[1], number: true,
  },
  {
    // Of one that was never shaken hands with nobody knows it.
    key: "lookup", label: "Lookup", text: (row) => (row.lookup_version > 0 ? String(row.lookup_version) : row.build ? "built-in" : NOTHING),
    by: (row) => row.lookup_version, number: true,
  },
  seen(),
];
