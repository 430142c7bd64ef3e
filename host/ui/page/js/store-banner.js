// @ts-check
/** The store's failure: a banner that stands for as long as it lasts, whenever the page was opened. */

import { h } from "./dom.js";
import { moment } from "./format.js";

/** Between two questions while it lasts, in milliseconds. */
const ASK_AGAIN_MS = 10_000;

/** Names of what is dropped, one and many. @type {[string, string, string][]} */
const KINDS = [
  ["windows", "window", "windows"], ["results", "result", "results"], ["telemetry_s", "second of telemetry", "seconds of telemetry"],
  ["events", "event", "events"], ["audits", "command of the audit", "commands of the audit"],
];

/**
 * The banner's lines; none while the store takes everything.
 * @param {any} health the answer of `/healthz`
 * @returns {string[]}
 */
export function bannerLines(health) {
  const failure = health?.store_failure;
  if (!failure) return [];
  const dropped = KINDS.map(([kind, one, many]) => [Number(failure.dropped?.[kind] ?? 0), one, many])
    .filter(([n]) => Number(n) > 0)
    .map(([n, one, many]) => `${n} ${n === 1 ? one : many}`);
  return [
    `The daemon does not store everything: ${failure.text}, since ${moment(failure.since_ms)}.`,
    dropped.length > 0 ? `Lost since then: ${dropped.join(", ")}.` : "Nothing is lost so far.",
    failure.advice,
  ];
}

export class StoreBanner {
  /**
   * @param {HTMLElement} root
   * @param {import("./stream.js").Stream} stream
   * @param {() => Promise<any>} ask the daemon's health
   */
  constructor(root, stream, ask) {
    this.root = root;
    this.ask = ask;
    this.timer = 0;
    stream.on("notice", (notice) => {
      if (notice.event === "store") this.look();
    });
    // A failure may begin after the first answer and before the stream that would tell of it.
    const ends = stream.on("devices", () => {
      ends();
      this.look();
    });
    // A daemon that comes back may be another one.
    let wasStale = false;
    stream.on("state", ({ stale }) => {
      if (wasStale && !stale) this.look();
      wasStale = stale;
    });
    this.look();
  }

  /** Asks, and shows what it hears; again while there is a failure or no answer. */
  async look() {
    clearTimeout(this.timer);
    const health = await this.ask().catch(() => undefined);
    // Without an answer the banner stands: the header says that the daemon is silent.
    if (health !== undefined) this.#show(bannerLines(health));
    if (health === undefined || !this.root.hidden) {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.look(), ASK_AGAIN_MS);
    }
  }

  /** @param {string[]} lines */
  #show(lines) {
    const text = lines.join("\n");
    if (this.root.dataset.text === text) return;
    this.root.dataset.text = text;
    this.root.hidden = lines.length === 0;
    this.root.replaceChildren(...lines.map((line) => h("p", {}, line)));
  }
}
