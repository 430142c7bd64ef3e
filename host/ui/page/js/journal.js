// @ts-check
/** The journal as a list that grows at both ends: live notices before it, older pages behind it. */

/**
 * @typedef {object} Entry
 * @property {number} at_ms since 1970, UTC
 * @property {string} device empty where the daemon itself speaks
 * @property {string} kind
 * @property {string} holder who asked, for a command
 * @property {string} text
 * @property {boolean} [live] told by the event stream, and not (yet) read from the journal
 */

/** Kinds that stand out: something is wrong. */
const ALARMS = new Set(["damage", "no lookup", "missed"]);

/** What comes several times a second, and has views of its own. */
const TOO_MANY = new Set(["telemetry", "window-stored", "result-stored"]);

/** How far the clocks of a notice and of its journal entry lie apart at most, in milliseconds. */
const SAME_MS = 3000;

/** Whether an entry is to stand out. @param {Entry} entry */
export function isAlarm(entry) {
  if (entry.kind === "fault") return !/^(0\b|fault cleared|no fault)/.test(entry.text);
  if (entry.kind === "store") return !/works again/.test(entry.text);
  if (entry.kind === "lookup") return /was refused/.test(entry.text);
  if (entry.kind === "state") return /^(faulted|incompatible|suspended)/.test(entry.text);
  return ALARMS.has(entry.kind);
}

/**
 * A notice of the event stream as an entry, in the words in which the daemon keeps it (host/daemon/src/event_log.rs);
 * null for what comes too often to be told.
 * @param {any} notice
 * @returns {Entry | null}
 */
export function fromNotice(notice) {
  if (!notice || TOO_MANY.has(notice.event)) return null;
  const entry = (/** @type {string} */ kind, /** @type {string} */ text, holder = "") => ({
    at_ms: Number(notice.at_ms),
    device: String(notice.device ?? ""),
    kind,
    holder,
    text,
    live: true,
  });
  switch (notice.event) {
    case "state":
      return entry("state", notice.detail ? `${notice.state}: ${notice.detail}` : String(notice.state));
    case "fault":
      return entry("fault", notice.fault === 0 ? "fault cleared" : `${notice.fault}: ${notice.text}`);
    case "lookup-active":
      return entry("lookup", `version ${notice.version} is active, ${notice.observed_cells} cells known`);
    case "lookup-refused":
      return entry("lookup", `version ${notice.version} was refused: ${notice.why}`);
    case "window-refused":
      return entry("window", `window ${notice.seq} refused: ${notice.why}`);
    case "lease": {
      const who = notice.holder ? `${notice.holder} commands it` : `nobody commands it${notice.why ? `: ${notice.why}` : ""}`;
      return entry("lease", notice.taken_from ? `${who}, taken from ${notice.taken_from}` : who);
    }
    case "recording":
      return entry("recording", notice.file ? `${notice.file}: ${notice.text}` : String(notice.text));
    case "command":
      return entry("command", notice.ok ? String(notice.text) : `${notice.text}: not carried out`, String(notice.holder ?? ""));
    case "store":
      return entry("store", String(notice.text));
    default: {
      const { at_ms, device, event, ...rest } = notice;
      return entry(String(event ?? "notice"), typeof rest.text === "string" ? rest.text : JSON.stringify(rest));
    }
  }
}

/**
 * The list with a page that was read again from its newest end. A live entry goes where the journal has it, by device
 * and kind within three seconds; each journal entry stands for one of them. Of a device that never connected the journal has the name
 * in the text alone.
 * @param {Entry[]} list newest first
 * @param {Entry[]} page newest first
 * @returns {Entry[]} newest first
 */
export function withNewest(list, page) {
  const kept = list.filter((entry) => !entry.live);
  const isNew = absent(page, kept);
  const free = [...isNew];
  const live = list.filter((entry) => {
    if (!entry.live) return false;
    const at = free.findIndex(
      (told) => (told.device === entry.device || (told.device === "" && told.text.startsWith(`${entry.device}: `))) && told.kind === entry.kind && Math.abs(told.at_ms - entry.at_ms) <= SAME_MS,
    );
    if (at >= 0) free.splice(at, 1);
    return at < 0;
  });
  return newestFirst([...live, ...isNew, ...kept]);
}

/** The list with an older page behind it; what both hold stands once. @param {Entry[]} list @param {Entry[]} page */
export const withOlder = (list, page) => newestFirst([...list, ...absent(page, list.filter((entry) => !entry.live))]);

/**
 * Entries of a page that a list lacks. Equal entries count: two that happened in the same millisecond are two.
 * @param {Entry[]} page
 * @param {Entry[]} list
 */
function absent(page, list) {
  const rest = new Map();
  const key = (/** @type {Entry} */ e) => JSON.stringify([e.at_ms, e.device, e.kind, e.holder, e.text]);
  for (const entry of list) rest.set(key(entry), (rest.get(key(entry)) ?? 0) + 1);
  return page.filter((entry) => {
    const left = rest.get(key(entry)) ?? 0;
    if (left > 0) rest.set(key(entry), left - 1);
    return left === 0;
  });
}

/** Stable: entries of one moment keep their order. @param {Entry[]} list */
const newestFirst = (list) => list.sort((a, b) => b.at_ms - a.at_ms);

/** Most entries of a page. */
export const MAX_OF_PAGE = 10_000;

/**
 * What to ask for to get older entries. The millisecond of the oldest is asked for again, since more may have happened
 * in it than the last page had room for.
 * @param {Entry[]} list newest first
 * @param {number} limit
 * @param {number} stuck how many pages in a row brought nothing new: each asks for twice as many
 * @returns {{before: number, limit: number} | null} null where there is nothing to begin from
 */
export function older(list, limit, stuck) {
  const oldest = list.findLast((entry) => !entry.live);
  if (!oldest) return null;
  return { before: oldest.at_ms + 1, limit: Math.min(limit * 2 ** stuck, MAX_OF_PAGE) };
}

/**
 * @typedef {object} Filter
 * @property {string | null} device null for all, empty for the daemon itself
 * @property {string} kind empty for all
 * @property {string} text in any case; empty for all
 * @property {number | null} since_ms
 * @property {number | null} before_ms
 */

/** @param {Entry} entry @param {Filter} filter */
export function matches(entry, filter) {
  if (filter.device !== null && entry.device !== filter.device) return false;
  if (filter.kind && entry.kind !== filter.kind) return false;
  if (filter.since_ms !== null && entry.at_ms < filter.since_ms) return false;
  if (filter.before_ms !== null && entry.at_ms >= filter.before_ms) return false;
  const wanted = filter.text.trim().toLowerCase();
  return !wanted || `${entry.device} ${entry.kind} ${entry.holder} ${entry.text}`.toLowerCase().includes(wanted);
}
