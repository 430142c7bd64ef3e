// @ts-check
/** A sample of a curve for legends: told apart by colour, dash and marker. */

import { svg } from "./dom.js";

/**
 * @param {{colour: string, dash?: number[], marker?: string, line?: boolean, width?: number}} look
 * @returns {SVGElement}
 */
export function swatch(look) {
  const drawing = svg("svg", { width: 22, height: 10, viewBox: "0 0 22 10", "aria-hidden": "true", class: `swatch stroke-${look.colour}` });
  if (look.line !== false) {
    drawing.append(svg("line", { x1: 0, x2: 22, y1: 5, y2: 5, "stroke-width": Math.max(1.5, look.width ?? 1.5), "stroke-dasharray": (look.dash ?? []).join(" ") || "none" }));
  }
  if (look.marker) drawing.append(markerShape(look.marker));
  return drawing;
}

/** @param {string} marker */
function markerShape(marker) {
  if (marker === "square") return svg("rect", { x: 8, y: 2, width: 6, height: 6, class: "filled" });
  if (marker === "triangle") return svg("path", { d: "M11 1 L15 8 L7 8 Z", class: "filled" });
  if (marker === "cross") return svg("path", { d: "M8 2 L14 8 M14 2 L8 8", "stroke-width": 1.5 });
  return svg("circle", { cx: 11, cy: 5, r: 3, class: "filled" });
}
