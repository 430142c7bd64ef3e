// @ts-check
/** The heat map as a PNG: cells, hatching, colour bar, working point and limits, drawn anew at a size for reports. */

import { css, inkOn } from "../colour.js";
import { colourOf, hatchOn, pieces } from "../heatmap.js";
import { cellText, coordinate } from "./values.js";
import { tickText, title } from "./words.js";

const SCALE = 2;
const [LEFT, TOP, CELL_W, CELL_H, BELOW] = [64, 58, 54, 40, 128];
const HATCH = { light: "rgb(255 255 255 / 34%)", dark: "rgb(0 0 0 / 42%)", faint: "rgb(0 0 0 / 17%)" };
const FONT = "12px system-ui, sans-serif";

/**
 * @typedef {object} Drawing
 * @property {import("../heatmap.js").Picture} picture
 * @property {string[]} lines title, and what it is of
 * @property {import("../heatmap.js").Point[]} trail oldest first; the newest is the working point
 * @property {boolean} on whether the hob works there now
 * @property {import("../heatmap.js").Limits | null} limits
 * @property {boolean} dark
 * @property {{paper: string, ink: string, quiet: string}} colours
 */

/**
 * @param {Drawing} drawing
 * @returns {Promise<Blob>}
 */
export function png(drawing) {
  const { f_sw_hz, i_a } = drawing.picture;
  const canvas = document.createElement("canvas");
  const width = LEFT + CELL_W * i_a.length + 24;
  const height = TOP + CELL_H * f_sw_hz.length + BELOW;
  canvas.width = width * SCALE;
  canvas.height = height * SCALE;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.scale(SCALE, SCALE);
  context.fillStyle = drawing.colours.paper;
  context.fillRect(0, 0, width, height);
  cells(context, drawing);
  axes(context, drawing);
  over(context, drawing);
  bar(context, drawing, width);
  return new Promise((resolve, reject) =>
    canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("the browser made no picture"))), "image/png"),
  );
}

/** @param {CanvasRenderingContext2D} c @param {Drawing} drawing */
function cells(c, drawing) {
  const { picture } = drawing;
  const rows = picture.f_sw_hz.length;
  c.font = FONT;
  c.textAlign = "center";
  c.textBaseline = "middle";
  picture.f_sw_hz.forEach((_, f) =>
    picture.i_a.forEach((_, i) => {
      const [x, y] = [LEFT + CELL_W * i, TOP + CELL_H * (rows - 1 - f)];
      const value = picture.values[f]?.[i] ?? null;
      const colour = colourOf(picture, value, drawing.dark);
      const ink = colour ? inkOn(colour) : drawing.colours.ink;
      c.fillStyle = colour ? css(colour) : drawing.colours.paper;
      c.fillRect(x, y, CELL_W - 1, CELL_H - 1);
      if (!picture.observed[f]?.[i]) hatch(c, x, y, HATCH[hatchOn(colour)]);
      c.fillStyle = ink;
      c.fillText(cellText(picture.quantity, value, picture.scale), x + CELL_W / 2, y + 11);
    }),
  );
}

/** @param {CanvasRenderingContext2D} c */
function hatch(c, /** @type {number} */ x, /** @type {number} */ y, /** @type {string} */ stroke) {
  c.save();
  c.beginPath();
  c.rect(x, y, CELL_W - 1, CELL_H - 1);
  c.clip();
  c.strokeStyle = stroke;
  c.lineWidth = 1.5;
  c.beginPath();
  for (let k = -CELL_H; k < CELL_W; k += 7) {
    c.moveTo(x + k, y + CELL_H);
    c.lineTo(x + k + CELL_H, y);
  }
  c.stroke();
  c.restore();
}

/** @param {CanvasRenderingContext2D} c @param {Drawing} drawing */
function axes(c, drawing) {
  const { f_sw_hz, i_a } = drawing.picture;
  const rows = f_sw_hz.length;
  c.fillStyle = drawing.colours.ink;
  c.textAlign = "left";
  c.textBaseline = "alphabetic";
  c.font = "600 14px system-ui, sans-serif";
  c.fillText(drawing.lines[0], LEFT, 22);
  c.font = FONT;
  c.fillStyle = drawing.colours.quiet;
  c.fillText(drawing.lines.slice(1).join("  ·  "), LEFT, 41);
  c.fillStyle = drawing.colours.ink;
  c.textBaseline = "middle";
  c.textAlign = "right";
  f_sw_hz.forEach((f, k) => c.fillText((f / 1000).toFixed(1), LEFT - 8, TOP + CELL_H * (rows - 0.5 - k)));
  c.textAlign = "center";
  i_a.forEach((i, k) => c.fillText(i.toFixed(1), LEFT + CELL_W * (k + 0.5), TOP + CELL_H * rows + 13));
  c.fillText("amplitude of the current's fundamental / A", LEFT + (CELL_W * i_a.length) / 2, TOP + CELL_H * rows + 32);
  c.save();
  c.translate(14, TOP + (CELL_H * rows) / 2);
  c.rotate(-Math.PI / 2);
  c.fillText("switching frequency / kHz", 0, 0);
  c.restore();
}

/** Limits, trail and working point. @param {CanvasRenderingContext2D} c @param {Drawing} drawing */
function over(c, drawing) {
  const { f_sw_hz, i_a } = drawing.picture;
  const [width, height] = [CELL_W * i_a.length, CELL_H * f_sw_hz.length];
  const at = (/** @type {import("../heatmap.js").Point} */ point) => [
    LEFT + CELL_W * (coordinate(i_a, point.i_a, false) + 0.5),
    TOP + height - CELL_H * (coordinate(f_sw_hz, point.f_sw_hz, true) + 0.5),
  ];
  c.save();
  c.beginPath();
  c.rect(LEFT, TOP, width, height);
  c.clip();
  const line = (/** @type {number[][]} */ points, /** @type {number[]} */ dash) => {
    for (const [colour, size, dashes] of /** @type {[string, number, number[]][]} */ ([["#ffffff", 4, []], ["#000000", 1.6, dash]])) {
      c.strokeStyle = colour;
      c.lineWidth = size;
      c.setLineDash(dashes);
      c.beginPath();
      points.forEach(([x, y], k) => (k === 0 ? c.moveTo(x, y) : c.lineTo(x, y)));
      c.stroke();
    }
    c.setLineDash([]);
  };
  if (drawing.limits) {
    for (const f of [drawing.limits.f_min_hz, drawing.limits.f_max_hz]) {
      const [, y] = at({ f_sw_hz: f, i_a: 1 });
      line([[LEFT, y], [LEFT + width, y]], [7, 5]);
    }
    const [x] = at({ f_sw_hz: f_sw_hz[0], i_a: drawing.limits.i_max_a });
    line([[x, TOP], [x, TOP + height]], [7, 5]);
    for (const piece of pieces(i_a, drawing.limits.lowest_hz)) line(piece.map(at), [2, 3]);
  }
  if (drawing.trail.length > 1) line(drawing.trail.map(at), []);
  const now = drawing.on ? drawing.trail[drawing.trail.length - 1] : undefined;
  if (now) {
    const [x, y] = at(now);
    for (const [colour, size] of /** @type {[string, number][]} */ ([["#ffffff", 6], ["#000000", 2.5]])) {
      c.strokeStyle = colour;
      c.lineWidth = size;
      c.beginPath();
      c.arc(x, y, 8, 0, 2 * Math.PI);
      c.stroke();
    }
  }
  c.restore();
}

/** @param {CanvasRenderingContext2D} c @param {Drawing} drawing @param {number} width of the picture */
function bar(c, drawing, width) {
  const { picture } = drawing;
  const { scale, quantity } = picture;
  const [x0, y0, w] = [LEFT + 150, TOP + CELL_H * picture.f_sw_hz.length + 56, width - LEFT - 24 - 150];
  const place = (/** @type {number} */ value) => (quantity.scale === "diverging" ? (scale.place(value) + 1) / 2 : scale.place(value));
  const steps = 256;
  for (let k = 0; k < steps; k++) {
    c.fillStyle = barColour(picture, k / (steps - 1), drawing.dark);
    c.fillRect(x0 + (w * k) / steps, y0, w / steps + 0.6, 14);
  }
  c.fillStyle = drawing.colours.ink;
  c.textBaseline = "middle";
  c.textAlign = "left";
  c.fillText(title(quantity, scale), LEFT, y0 + 7);
  c.textAlign = "center";
  for (const tick of scale.ticks) {
    const x = x0 + w * place(tick);
    c.fillRect(x - 0.5, y0 + 14, 1, 4);
    c.fillText(tickText(quantity, tick, scale), x, y0 + 27);
  }
  c.textAlign = "left";
  c.fillStyle = drawing.colours.quiet;
  c.fillText("hatched: not known, the prior or a guess   dashed: limits of f_sw and current   dotted: resonance margin   ring: working point, its trail", LEFT, y0 + 52);
}

/**
 * Colour of the bar at a place along it.
 * @param {import("../heatmap.js").Picture} picture
 * @param {number} t 0 to 1
 * @param {boolean} dark
 * @returns {string}
 */
export function barColour(picture, t, dark) {
  const along = { ...picture, scale: { ...picture.scale, place: (/** @type {number} */ v) => v } };
  const at = picture.quantity.scale === "diverging" ? 2 * t - 1 : t;
  return css(/** @type {import("../colour.js").Rgb} */ (colourOf(along, at, dark)));
}
