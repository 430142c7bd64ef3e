// @ts-check
/**
 * The other pages of this daemon in the browser: they hear when one of them logs out, as the session is theirs too; and their number, for a
 * browser without shared workers.
 *
 * In such a one each page has an event stream of its own, and a browser opens six connections to a host over HTTP/1.1: with six pages open,
 * none could say Off. So hidden pages that heat nothing let theirs go where there are several.
 */

/** A page says that it is there so often, in milliseconds; timers of hidden ones may be throttled to one a minute. */
const SAY_MS = 10_000;
const FORGET_MS = 150_000;

/** So many pages may hold their stream while hidden. */
export const MAX_STREAMS = 3;

/** The longest wait for the others to give up what they heat, in milliseconds. */
export const LEAVE_MS = 2000;

export class Tabs {
  /**
   * @param {() => void} changed called when pages come and go
   * @param {() => Promise<void>} giveUp ends what this page heats, as another one is about to end the session
   */
  constructor(changed, giveUp) {
    /** Others that have yet to give up what they heat. @type {Set<string>} */
    this.awaited = new Set();
    this.giveUp = giveUp;
    this.own = crypto.getRandomValues(new Uint32Array(2)).join("-");
    /** Others, and when each was heard last. @type {Map<string, number>} */
    this.others = new Map();
    this.changed = changed;
    this.channel = openChannel();
    this.channel.addEventListener("message", (event) => this.#heard(event.data));
    addEventListener("pagehide", () => this.channel.postMessage({ id: this.own, gone: true }));
    addEventListener("pageshow", () => this.#say(true));
    setInterval(() => this.#say(false), SAY_MS);
    this.#say(true);
  }

  /** @returns {number} pages that are open, this one too */
  count() {
    const now = performance.now();
    for (const [id, at] of this.others) if (now - at > FORGET_MS) this.others.delete(id);
    return this.others.size + 1;
  }

  /** Has the other pages give up what they heat: resolves when they have, at the latest after {@link LEAVE_MS}. */
  leave() {
    this.awaited = new Set(this.others.keys());
    this.channel.postMessage({ id: this.own, leaves: true });
    return new Promise((/** @type {(value: void) => void} */ resolve) => {
      this.allGaveUp = resolve;
      this.#gaveUp("");
      setTimeout(resolve, LEAVE_MS);
    });
  }

  /** @param {string} id */
  #gaveUp(id) {
    this.awaited.delete(id);
    if (this.awaited.size === 0) this.allGaveUp();
  }

  allGaveUp = () => {};

  /** @param {boolean} asks whether the others are to answer */
  #say(asks) {
    this.channel.postMessage({ id: this.own, asks });
  }

  /** @param {{id: string, gone?: boolean, asks?: boolean, leaves?: boolean, gaveUp?: boolean}} told */
  #heard(told) {
    const before = this.others.size;
    if (told.gone) this.others.delete(told.id);
    else this.others.set(told.id, performance.now());
    if (told.asks) this.#say(false);
    if (told.leaves) this.giveUp().then(() => this.channel.postMessage({ id: this.own, gaveUp: true }));
    if (told.gaveUp || told.gone) this.#gaveUp(told.id);
    if (this.others.size !== before) this.changed();
  }
}

/** @returns {BroadcastChannel | MessagePort} the channel of all pages; one that nobody hears where the browser denies storage */
function openChannel() {
  try {
    return new BroadcastChannel("ihd-pages");
  } catch {
    return new MessageChannel().port1;
  }
}
