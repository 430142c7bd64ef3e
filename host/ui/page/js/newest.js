// @ts-check
/** Newest wins: never two requests under way; what was asked for meanwhile is done once, with the newest wish. */

/**
 * @template W
 */
export class Newest {
  /**
   * @param {(wish: W, signal: AbortSignal) => Promise<void>} work
   * @param {(why: unknown) => void} failed
   */
  constructor(work, failed) {
    this.work = work;
    this.failed = failed;
    /** @type {{wish: W} | null} */
    this.waiting = null;
    this.busy = false;
    this.abort = new AbortController();
  }

  /** @param {W} wish */
  ask(wish) {
    this.waiting = { wish };
    if (!this.busy) this.#run();
  }

  /** Ends it: what is under way is aborted, what waits is dropped. */
  stop() {
    this.waiting = null;
    this.abort.abort();
  }

  async #run() {
    this.busy = true;
    while (this.waiting) {
      const { wish } = this.waiting;
      this.waiting = null;
      try {
        await this.work(wish, this.abort.signal);
      } catch (why) {
        if (!this.abort.signal.aborted) this.failed(why);
      }
      if (this.abort.signal.aborted) break;
    }
    this.busy = false;
  }
}
