// @ts-check
/** This page's end of the event stream that all pages of this browser share ({@link file://./stream-worker.js}). */

/** Events of a stream. */
export const EVENTS = ["telemetry", "devices", "notice", "missed"];

/** A browser without shared workers, or one whose worker failed: each page has a stream of its own. */
let isAlone = !("SharedWorker" in globalThis);

/** @returns {boolean} whether this page's stream is the other pages', too */
export function isShared() {
  return !isAlone;
}

/**
 * Opens the stream.
 * @param {string} url
 * @returns {Source}
 */
export function openStream(url) {
  if (!isAlone) {
    try {
      return new SharedSource(url);
    } catch {
      // A browser that denies storage denies shared workers.
      isAlone = true;
    }
  }
  return new EventSource(url);
}

/**
 * As much of an EventSource as a page uses.
 * @typedef {EventTarget & {close: () => void}} Source
 */

class SharedSource extends EventTarget {
  /** @param {string} url */
  constructor(url) {
    super();
    const worker = new SharedWorker(new URL("./stream-worker.js", import.meta.url), { type: "module", name: "ihd-stream" });
    this.port = worker.port;
    worker.addEventListener("error", () => {
      isAlone = true;
      this.dispatchEvent(new Event("error"));
    });
    this.port.addEventListener("message", ({ data: { name, text } }) => {
      if (name === "error") {
        this.dispatchEvent(new Event("error"));
        return;
      }
      this.port.postMessage({ type: "taken" });
      this.dispatchEvent(new MessageEvent(name, { data: text }));
    });
    this.port.start();
    this.port.postMessage({ type: "open", url });
    this.leave = () => this.port.postMessage({ type: "close" });
    addEventListener("pagehide", this.leave);
  }

  close() {
    removeEventListener("pagehide", this.leave);
    this.leave();
    this.port.close();
  }
}
