// @ts-check
/**
 * The event stream as a page hears it.
 *
 * `on` hears every event at once, for what keeps state; `frame` hears at most once an animation frame, for what
 * draws: never while the tab is hidden, with what came meanwhile merged into one.
 */

import { EVENTS, openStream } from "./shared-stream.js";
import { mergeTelemetry } from "./telemetry.js";

/** Silence after which what is shown is stale. The daemon sends something at least once a second. */
export const STALE_MS = 3000;

/** Silence after which the connection is given up and made anew. */
export const DEAD_MS = 8000;

const BACKOFF_FIRST_MS = 400;
const BACKOFF_MOST_MS = 8000;

/** Most notices that wait for a frame; a hidden tab drops the oldest, and counts them as missed. */
const MAX_NOTICES = 1000;

/**
 * What a stream tells of itself: `stale` since when (page's clock, ms), how often a connection failed in a row.
 * @typedef {{stale: boolean, silent_since_ms: number, failures: number}} StreamState
 */

export class Stream {
  /**
   * @param {string} url
   * @param {{open?: (url: string) => import("./shared-stream.js").Source, now?: () => number, clock?: () => number}} [world] `clock`: the daemon's,
   *   until its first telemetry; the others are of tests
   */
  constructor(url, world = {}) {
    this.url = url;
    this.open = world.open ?? openStream;
    this.now = world.now ?? (() => performance.now());
    this.clock = world.clock ?? (() => Date.now());
    /** @type {Map<string, Set<Function>>} */
    this.listeners = new Map();
    /** @type {Map<string, Set<Function>>} */
    this.drawers = new Map();
    /** @type {import("./shared-stream.js").Source | null} */
    this.source = null;
    this.lastHeard = this.now();
    this.opened = this.now();
    this.failures = 0;
    this.stale = false;
    /** Whether something was missed since the last telemetry. */
    this.gap = false;
    this.resting = false;
    this.retryTimer = 0;
    this.watchTimer = 0;
    this.frameRequested = 0;
    /** @type {Record<string, any>} */
    this.pending = {};
    /** Time of the daemon at the last telemetry, ms since 1970. */
    this.lastAt_ms = 0;
    this.lastTelemetry = 0;
    this.visibility = () => this.#requestFrame();
  }

  /** Connects, and goes on trying until {@link stop}. */
  start() {
    if (this.watchTimer) return;
    this.watchTimer = setInterval(() => this.#watch(), 250);
    document.addEventListener("visibilitychange", this.visibility);
    this.#connect();
  }

  /** Closes the connection for good. */
  stop() {
    clearInterval(this.watchTimer);
    clearTimeout(this.retryTimer);
    document.removeEventListener("visibilitychange", this.visibility);
    this.watchTimer = 0;
    this.retryTimer = 0;
    this.source?.close();
    this.source = null;
  }

  /** Lets the connection go until {@link wake}: for hidden pages among many. */
  rest() {
    if (this.resting || !this.watchTimer) return;
    this.resting = true;
    clearTimeout(this.retryTimer);
    this.source?.close();
    this.source = null;
  }

  /** Connects again; what came meanwhile is a gap. */
  wake() {
    if (!this.resting) return;
    this.resting = false;
    this.stale = true;
    this.#tellState();
    this.#connect();
  }

  /**
   * Hears every event at once: `telemetry`, `devices`, `notice`, `missed`, `state` ({@link StreamState}) and `gap`
   * (`{from_ms, to_ms}` of the daemon's clock, when events come again after a silence).
   * @param {string} name
   * @param {(data: any) => void} listener
   * @returns {() => void} ends it
   */
  on(name, listener) {
    return add(this.listeners, name, listener);
  }

  /**
   * Hears at most once an animation frame, and not while hidden. `telemetry` is merged, of `devices` the
   * newest comes, `notice` is a list of all since the last frame.
   * @param {"telemetry" | "devices" | "notice" | "missed"} name
   * @param {(data: any) => void} drawer
   * @returns {() => void} ends it
   */
  frame(name, drawer) {
    return add(this.drawers, name, drawer);
  }

  /** @returns {number} the daemon's clock now, as well as it is known, in ms since 1970 */
  daemonNow_ms() {
    return this.lastAt_ms ? this.lastAt_ms + (this.now() - this.lastTelemetry) : this.clock();
  }

  #connect() {
    this.source?.close();
    this.opened = this.now();
    const source = this.open(this.url);
    this.source = source;
    for (const name of EVENTS) {
      source.addEventListener(name, (event) => {
        if (source === this.source) this.#heard(name, /** @type {MessageEvent} */ (event).data);
      });
    }
    source.addEventListener("error", () => {
      if (source === this.source) this.#failed();
    });
  }

  /** Whatever the browser would do: its own wait is seconds, and for ever after an HTTP error. */
  #failed() {
    this.source?.close();
    this.source = null;
    this.failures += 1;
    const wait = Math.min(BACKOFF_MOST_MS, BACKOFF_FIRST_MS * 1.7 ** (this.failures - 1));
    clearTimeout(this.retryTimer);
    this.retryTimer = setTimeout(() => this.#connect(), wait * (0.8 + 0.4 * Math.random()));
    this.#tellState();
  }

  /**
   * @param {string} name
   * @param {string} text
   */
  #heard(name, text) {
    let data;
    try {
      data = JSON.parse(text);
    } catch {
      return;
    }
    this.lastHeard = this.now();
    if (this.stale || this.failures > 0) {
      this.stale = false;
      this.failures = 0;
      this.gap = true;
      this.#tellState();
    }
    if (name === "telemetry") {
      const before_ms = this.lastAt_ms;
      this.lastAt_ms = data.at_ms;
      this.lastTelemetry = this.lastHeard;
      if (this.gap) tell(this.listeners, "gap", { from_ms: before_ms || data.at_ms, to_ms: data.at_ms });
      this.gap = false;
    }
    tell(this.listeners, name, data);
    this.#keep(name, data);
  }

  /**
   * @param {string} name
   * @param {any} data
   */
  #keep(name, data) {
    if (!this.drawers.get(name)?.size) return;
    if (name === "telemetry") {
      this.pending.telemetry = this.pending.telemetry ? mergeTelemetry(this.pending.telemetry, data) : data;
    } else if (name === "notice") {
      const list = (this.pending.notice ??= []);
      list.push(data);
      if (list.length > MAX_NOTICES) {
        list.shift();
        this.pending.missed = { missed: (this.pending.missed?.missed ?? 0) + 1 };
      }
    } else if (name === "missed") {
      this.pending.missed = { missed: (this.pending.missed?.missed ?? 0) + data.missed };
    } else {
      this.pending[name] = data;
    }
    this.#requestFrame();
  }

  #requestFrame() {
    if (this.frameRequested || document.hidden || Object.keys(this.pending).length === 0) return;
    this.frameRequested = requestAnimationFrame(() => {
      this.frameRequested = 0;
      const pending = this.pending;
      this.pending = {};
      for (const name of ["devices", "telemetry", "notice", "missed"]) {
        if (pending[name] !== undefined) tell(this.drawers, name, pending[name]);
      }
    });
  }

  #watch() {
    if (this.resting) return;
    const silence = this.now() - this.lastHeard;
    if (!this.stale && silence > STALE_MS) {
      this.stale = true;
      this.#tellState();
    }
    if (this.source && silence > DEAD_MS && this.now() - this.opened > DEAD_MS) this.#failed();
  }

  /** @returns {StreamState} */
  get state() {
    return { stale: this.stale, silent_since_ms: this.lastHeard, failures: this.failures };
  }

  #tellState() {
    tell(this.listeners, "state", this.state);
  }

}

/**
 * @param {Map<string, Set<Function>>} where
 * @param {string} name
 * @param {Function} listener
 */
function add(where, name, listener) {
  const set = where.get(name) ?? new Set();
  where.set(name, set);
  set.add(listener);
  return () => {
    set.delete(listener);
  };
}

/**
 * @param {Map<string, Set<Function>>} where
 * @param {string} name
 * @param {any} data
 */
function tell(where, name, data) {
  for (const listener of where.get(name) ?? []) {
    try {
      listener(data);
    } catch (why) {
      console.error(`a listener of ${name} failed`, why);
    }
  }
}
