// @ts-check
/** Points of a curve in the shape that the legend shows: told apart without colour. */

import uPlot from "../vendor/uplot/uPlot.esm.js";

/**
 * Draws points for uPlot's `points.paths`.
 * @param {import("./plot.js").Marker} marker
 * @returns {(u: any, series: number, first: number, last: number) => any}
 */
export function markerPaths(marker) {
  return (u, series, first, last) => {
    const { points, scale } = u.series[series];
    const half = (points.size / 2) * uPlot.pxRatio;
    const path = new Path2D();
    const [xs, ys] = [u.data[0], u.data[series]];
    for (let k = first; k <= last; k += 1) {
      if (ys[k] === null || ys[k] === undefined) continue;
      add(path, marker, u.valToPos(xs[k], "x", true), u.valToPos(ys[k], scale, true), half);
    }
    const { left, top, width, height } = u.bbox;
    const clip = new Path2D();
    clip.rect(left - half, top - half, width + 2 * half, height + 2 * half);
    return { stroke: path, fill: marker === "cross" ? null : path, clip, flags: 3 };
  };
}

/** @param {Path2D} path @param {import("./plot.js").Marker} marker @param {number} x @param {number} y @param {number} half of its size */
function add(path, marker, x, y, half) {
  if (marker === "square") {
    path.rect(x - half, y - half, 2 * half, 2 * half);
  } else if (marker === "triangle") {
    path.moveTo(x, y - half * 1.2);
    path.lineTo(x + half * 1.1, y + half);
    path.lineTo(x - half * 1.1, y + half);
    path.closePath();
  } else if (marker === "cross") {
    path.moveTo(x - half, y - half);
    path.lineTo(x + half, y + half);
    path.moveTo(x + half, y - half);
    path.lineTo(x - half, y + half);
  } else {
    path.moveTo(x + half, y);
    path.arc(x, y, half, 0, 2 * Math.PI);
  }
}
