// @ts-check
/** Marks on plots beside their curves: levels, and points with error bars. */

/** Points of the network keep so much distance, in device pixels, so that bars can be told apart. */
const MIN_DISTANCE = 3;

/**
 * A limit as a dotted line.
 * @param {any} u
 * @param {import("../theme.js").Theme} theme
 * @param {number} value
 */
export function level(u, theme, value) {
  const y = u.valToPos(value, "y", true);
  const { ctx, bbox } = u;
  ctx.strokeStyle = theme.colour("s7");
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
  ctx.beginPath();
  ctx.moveTo(bbox.left, y);
  ctx.lineTo(bbox.left + bbox.width, y);
  ctx.stroke();
  ctx.setLineDash([]);
}

/**
 * Results of the network: a point with a bar of ± 2σ, a cross where the gate refused it.
 * @param {any} u
 * @param {import("../theme.js").Theme} theme
 * @param {{at_s: number[], value: (number | null)[], sigma: (number | null)[], pass: boolean[]}} points sigma in percent
 */
export function bars(u, theme, points) {
  const { ctx } = u;
  const px = devicePixelRatio;
  const { min, max } = u.scales.x;
  const passed = new Path2D();
  const dots = new Path2D();
  const refused = new Path2D();
  let before = -Infinity;
  for (let k = 0; k < points.at_s.length; k += 1) {
    const at = points.at_s[k];
    const value = points.value[k];
    if (value === null || at < min || at > max) continue;
    const x = u.valToPos(at, "x", true);
    if (x - before < MIN_DISTANCE * px) continue;
    before = x;
    const y = u.valToPos(value, "y", true);
    if (points.pass[k]) {
      const spread = (value * 2 * (points.sigma[k] ?? 0)) / 100;
      passed.moveTo(x, u.valToPos(value - spread, "y", true));
      passed.lineTo(x, u.valToPos(value + spread, "y", true));
      dots.rect(x - 1.5 * px, y - 1.5 * px, 3 * px, 3 * px);
    } else {
      cross(refused, x, y, 3 * px);
    }
  }
  ctx.lineWidth = px;
  ctx.strokeStyle = theme.colour("s1");
  ctx.stroke(passed);
  ctx.fillStyle = theme.colour("s1");
  ctx.fill(dots);
  ctx.strokeStyle = theme.colour("s4");
  ctx.lineWidth = 1.5 * px;
  ctx.stroke(refused);
}

/**
 * @param {Path2D} path
 * @param {number} x
 * @param {number} y
 * @param {number} size
 */
function cross(path, x, y, size) {
  path.moveTo(x - size, y - size);
  path.lineTo(x + size, y + size);
  path.moveTo(x + size, y - size);
  path.lineTo(x - size, y + size);
}
