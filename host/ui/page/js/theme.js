// @ts-check
/** Light, dark, or as the system has it; colours of plots come from the style sheet's variables. */

const KEY = "ihd-theme";

export class Theme {
  constructor() {
    const kept = read();
    /** @type {"auto" | "light" | "dark"} */
    this.mode = kept === "light" || kept === "dark" ? kept : "auto";
    this.system = matchMedia("(prefers-color-scheme: dark)");
    /** @type {Set<() => void>} */
    this.listeners = new Set();
    /** @type {Map<string, string>} */
    this.colours = new Map();
    this.system.addEventListener("change", () => this.#changed());
    this.#changed();
  }

  /** Whether it is dark now. */
  get dark() {
    return this.mode === "auto" ? this.system.matches : this.mode === "dark";
  }

  /** @param {"auto" | "light" | "dark"} mode */
  set(mode) {
    this.mode = mode;
    try {
      localStorage.setItem(KEY, mode);
    } catch {
      // Without storage the choice lasts as long as the page.
    }
    this.#changed();
  }

  /**
   * Colour of a variable of page.css, without its dashes: `s1`, `grid`, `ink`.
   * @param {string} name
   * @returns {string}
   */
  colour(name) {
    let colour = this.colours.get(name);
    if (colour === undefined) {
      colour = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
      this.colours.set(name, colour);
    }
    return colour;
  }

  /**
   * @param {() => void} listener called after a change
   * @returns {() => void} ends it
   */
  on(listener) {
    this.listeners.add(listener);
    return () => {
      this.listeners.delete(listener);
    };
  }

  #changed() {
    document.documentElement.dataset.theme = this.dark ? "dark" : "light";
    this.colours.clear();
    for (const listener of this.listeners) listener();
  }
}

function read() {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null;
  }
}
