// @ts-check
/** Windows before the last one, drawn below it, fading. */

import { scopeData } from "./scope-data.js";

export class Persistence {
  /** @param {number} most windows that are kept; 0 for none */
  constructor(most) {
    this.most = most;
    /** @type {{key: string, from_s: number, to_s: number, data: number[][]}[]} newest first */
    this.kept = [];
  }

  /** Forgets them all. */
  clear() {
    this.kept = [];
  }

  /**
   * A window makes place for the next one.
   * @param {any} before
   * @param {any} after
   */
  push(before, after) {
    if (this.most === 0 || !before || keyOf(before) === keyOf(after)) return;
    this.kept.unshift({ key: keyOf(before), from_s: before.from_s, to_s: before.to_s, data: scopeData(before) });
    this.kept.length = Math.min(this.kept.length, this.most);
  }

  /**
   * @param {any} u
   * @param {import("../theme.js").Theme} theme
   * @param {any} shown
   */
  draw(u, theme, shown) {
    if (!shown) return;
    for (let age = this.kept.length - 1; age >= 0; age -= 1) {
      const { key, data } = this.kept[age];
      if (key === keyOf(shown)) continue;
      u.ctx.globalAlpha = 0.45 * (1 - age / (this.most + 1));
      stroke(u, data[0], data[1], "v", theme.colour("s1"));
      stroke(u, data[0], data[2], "i", theme.colour("s2"));
    }
    u.ctx.globalAlpha = 1;
  }
}

/** @param {any} scope */
function keyOf(scope) {
  return `${scope.boot}-${scope.seq}`;
}

/**
 * @param {any} u
 * @param {number[]} t
 * @param {number[]} y
 * @param {string} scale
 * @param {string} colour
 */
function stroke(u, t, y, scale, colour) {
  const { ctx } = u;
  ctx.strokeStyle = colour;
  ctx.lineWidth = devicePixelRatio;
  ctx.beginPath();
  for (let k = 0; k < t.length; k += 1) ctx.lineTo(u.valToPos(t[k], "x", true), u.valToPos(y[k], scale, true));
  ctx.stroke();
}
