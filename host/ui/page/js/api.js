// @ts-check
/** Requests to the daemon. A refusal becomes an {@link ApiError} with the daemon's own message. */

const ROOT = new URL("../../api/v1/", import.meta.url);

/** Longest wait for an answer, in milliseconds: the server's own limit is 20 s. */
const TIMEOUT_MS = 21_000;

/** A request that was refused, or that nobody answered. */
export class ApiError extends Error {
  /**
   * @param {number} status HTTP status; 0 where nobody answered
   * @param {{error: string, message: string, [field: string]: any}} problem
   */
  constructor(status, problem) {
    super(problem.message);
    this.name = "ApiError";
    this.status = status;
    this.error = problem.error;
    this.problem = problem;
  }
}

/** The daemon's clock before this machine's, in milliseconds, as the last answer showed it: to a second. */
let ahead_ms = 0;

/** @returns {number} the daemon's clock now, to a second, in ms since 1970 */
export function daemonClock_ms() {
  return Date.now() + ahead_ms;
}

/**
 * Address of a route, for links and downloads.
 * @param {string} path below /api/v1, e.g. `devices/bench/history?columns=600`
 * @returns {string}
 */
export function address(path) {
  return new URL(path, ROOT).href;
}

/**
 * A path from parts; each is escaped.
 * @param {string[]} parts
 * @param {Record<string, string | number | null | undefined>} [query] null is left out
 * @returns {string}
 */
export function path(parts, query = {}) {
  const asked = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) {
    if (value !== null && value !== undefined) asked.set(name, String(value));
  }
  const text = asked.toString();
  return parts.map(encodeURIComponent).join("/") + (text ? `?${text}` : "");
}

/** The daemon's health; a store that fails answers 503, with why. @returns {Promise<any>} */
export async function health() {
  const response = await fetch(new URL("../../healthz", import.meta.url), { cache: "no-store" });
  return response.json();
}

/**
 * @typedef {{method?: string, body?: any, holder?: string, signal?: AbortSignal, keepalive?: boolean,
 *   timeoutMs?: number}} RequestOptions
 */

/**
 * @param {string} where
 * @param {RequestOptions} [options]
 * @returns {Promise<any>} the JSON of the answer, null without a body
 */
export async function request(where, options = {}) {
  /** @type {Record<string, string>} */
  const headers = { accept: "application/json" };
  if (options.holder) headers["ihd-holder"] = options.holder;
  if (options.body !== undefined) headers["content-type"] = "application/json";
  // Not AbortSignal.timeout: it would keep the answer alive until its time is over.
  const abort = new AbortController();
  let late = false;
  const timer = setTimeout(() => {
    late = true;
    abort.abort();
  }, options.timeoutMs ?? TIMEOUT_MS);
  const given = () => abort.abort();
  options.signal?.addEventListener("abort", given);
  if (options.signal?.aborted) abort.abort();
  let response;
  let text;
  try {
    response = await fetch(address(where), {
      method: options.method ?? "GET",
      headers,
      body: options.body === undefined ? undefined : JSON.stringify(options.body),
      signal: abort.signal,
      keepalive: options.keepalive ?? false,
      credentials: "same-origin",
      cache: "no-store",
    });
    const date_ms = Date.parse(response.headers.get("date") ?? "");
    // The header is cut to whole seconds: less than two are no difference.
    if (Number.isFinite(date_ms)) ahead_ms = Math.abs(date_ms - Date.now()) < 2000 ? 0 : date_ms + 500 - Date.now();
    text = await response.text();
  } catch (why) {
    if (options.signal?.aborted) throw why;
    const message = late ? "the daemon did not answer in time" : "the daemon cannot be reached";
    throw new ApiError(0, { error: late ? "time-out" : "unreachable", message });
  } finally {
    clearTimeout(timer);
    options.signal?.removeEventListener("abort", given);
  }
  return answer(response, text);
}

/**
 * @param {Response} response
 * @param {string} text
 */
function answer(response, text) {
  let json = null;
  try {
    json = text ? JSON.parse(text) : null;
  } catch {
    if (response.ok) {
      throw new ApiError(response.status, { error: "answer", message: "the daemon's answer is no JSON; reload the page" });
    }
  }
  if (response.ok) return json;
  const problem = json && typeof json.message === "string"
    ? json
    : { error: "status", message: `the daemon answered ${response.status} ${response.statusText}` };
  throw new ApiError(response.status, problem);
}

/**
 * @param {string} where
 * @param {RequestOptions} [options]
 */
export function get(where, options = {}) {
  return request(where, options);
}

/** Of one load of the page, so that a copied tab is somebody else. */
const LOAD = crypto.getRandomValues(new Uint32Array(1))[0].toString(16).padStart(8, "0").slice(0, 4);

const NAME_KEY = "ihd-name";

/** @returns {string} what the person calls himself; `page` where he has not said */
export function ownName() {
  try {
    return localStorage.getItem(NAME_KEY) || "page";
  } catch {
    return "page";
  }
}

/**
 * Keeps the name for this browser; what a header may not hold is left out.
 * @param {string} name
 */
export function setOwnName(name) {
  const kept = name.replaceAll(/[^\x21-\x7e]+/g, "-").slice(0, 32);
  try {
    if (kept) localStorage.setItem(NAME_KEY, kept);
    else localStorage.removeItem(NAME_KEY);
  } catch {
    // Without storage it is `page`.
  }
}

/** As it was when the page was loaded: a lease's name does not change while it is held. */
let holderName = ownName();

/** @returns {string} name under which this page commands: told to others */
export function holder() {
  return `${holderName}-${LOAD}`;
}

/** Takes a new name over; not while a lease is held. */
export function useOwnName() {
  holderName = ownName();
}

/**
 * Carries out a command under this page's name.
 * @param {string} device
 * @param {{command: string, [field: string]: any}} body
 * @param {RequestOptions} [options]
 * @returns {Promise<{text: string, file: string | null}>}
 */
export function command(device, body, options = {}) {
  return request(path(["devices", device, "commands"]), { ...options, method: "POST", body, holder: holder() });
}

/**
 * Takes or renews the lease.
 * @param {string} device
 * @param {boolean} force
 * @param {RequestOptions} [options]
 * @returns {Promise<{holder: string, expires_in_s: number}>}
 */
export function takeLease(device, force, options = {}) {
  return request(path(["devices", device, "lease"]), { ...options, method: "PUT", body: { force }, holder: holder() });
}

/**
 * Gives the lease back; the power that was asked for under it ends.
 * @param {string} device
 * @param {RequestOptions} [options]
 */
export function releaseLease(device, options = {}) {
  return request(path(["devices", device, "lease"]), { ...options, method: "DELETE", holder: holder() });
}
