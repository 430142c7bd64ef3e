// @ts-check
/**
 * The one event stream of this browser, handed on to all pages of this daemon: over HTTP/1.1 a browser opens six connections to a
 * host, and a stream of its own for each page would leave none for Off.
 *
 * A page says `open` and `close`, and `taken` for each event that it has got: one that hangs is not told more than {@link MAX_BEHIND},
 * and what it misses is counted.
 */

import { EVENTS } from "./shared-stream.js";
import { DEAD_MS } from "./stream.js";

/** Events that a page may have before it. */
const MAX_BEHIND = 100;

/** @type {Map<MessagePort, {behind: number, missed: number}>} */
const pages = new Map();
/** @type {EventSource | null} */
let source = null;
let heard_ms = 0;
/** The last word on all devices, for pages that come later. */
let devices = "";

self.addEventListener("connect", (event) => {
  const [port] = /** @type {MessageEvent} */ (event).ports;
  port.addEventListener("message", ({ data }) => {
    if (data.type === "open") open(port, data.url);
    else if (data.type === "close") close(port);
    else if (data.type === "taken") taken(port);
  });
  port.start();
});

/** @param {MessagePort} port @param {string} url */
function open(port, url) {
  pages.set(port, { behind: 0, missed: 0 });
  if (source && performance.now() - heard_ms < DEAD_MS) {
    if (devices) give(port, "devices", devices);
  } else {
    connect(url);
  }
}

/** @param {MessagePort} port */
function close(port) {
  pages.delete(port);
  if (pages.size > 0) return;
  source?.close();
  source = null;
}

/** @param {string} url */
function connect(url) {
  source?.close();
  const opened = new EventSource(url);
  source = opened;
  heard_ms = performance.now();
  devices = "";
  for (const name of EVENTS) {
    opened.addEventListener(name, ({ data }) => {
      if (opened !== source) return;
      heard_ms = performance.now();
      if (name === "devices") devices = data;
      for (const port of pages.keys()) give(port, name, data);
    });
  }
  opened.addEventListener("error", () => {
    if (opened !== source) return;
    opened.close();
    source = null;
    // Each opens it again when it thinks fit: the first for all.
    for (const port of pages.keys()) port.postMessage({ name: "error" });
    pages.clear();
  });
}

/** @param {MessagePort} port @param {string} name @param {string} text */
function give(port, name, text) {
  const page = pages.get(port);
  if (!page) return;
  if (page.behind >= MAX_BEHIND) {
    if (name === "notice") page.missed += 1;
    if (name === "missed") page.missed += JSON.parse(text).missed;
    return;
  }
  page.behind += 1;
  port.postMessage({ name, text });
}

/** @param {MessagePort} port */
function taken(port) {
  const page = pages.get(port);
  if (!page) return;
  page.behind -= 1;
  if (page.missed === 0) return;
  const missed = page.missed;
  page.missed = 0;
  give(port, "missed", JSON.stringify({ missed }));
}
