// @ts-check
/** What is seen of a plot as PNG: with title, device, time and legend. */

import { download, fileName } from "./export.js";
import { dateTime } from "./format.js";

/**
 * @param {import("./plot.js").Plot} plot
 */
export function exportPng(plot) {
  const { title, name, device } = plot.options;
  toPng(compose(plot), fileName([device(), name], Date.now(), "png"));
  plot.options.announce(`${title} saved as PNG`);
}

/**
 * Hands a drawing to the person.
 * @param {HTMLCanvasElement} canvas
 * @param {string} file
 */
export function toPng(canvas, file) {
  canvas.toBlob((blob) => {
    if (blob) download(file, blob);
  }, "image/png");
}

/**
 * The plot's own drawing below a head of its own.
 * @param {import("./plot.js").Plot} plot
 * @returns {HTMLCanvasElement}
 */
function compose(plot) {
  const { theme, title, device, series, notes } = plot.options;
  const source = plot.uplot.ctx.canvas;
  const ratio = source.width / plot.uplot.width;
  const entries = [
    ...series.filter((one, i) => !one.band && plot.uplot.series[i + 1].show),
    ...(notes ?? []),
  ];
  const canvas = document.createElement("canvas");
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.font = "11px system-ui, sans-serif";
  const places = layOut(context, entries, plot.uplot.width);
  const head = 22 + 16 * (places.length ? places[places.length - 1].row + 1 : 0) + 4;
  canvas.width = source.width;
  canvas.height = source.height + Math.round(head * ratio);
  context.scale(ratio, ratio);
  context.fillStyle = theme.colour("paper");
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.fillStyle = theme.colour("ink");
  context.textBaseline = "middle";
  context.font = "600 12px system-ui, sans-serif";
  context.fillText(`${title} — ${device()} — ${dateTime(plot.at_ms)}`, 6, 12);
  context.font = "11px system-ui, sans-serif";
  for (const { entry, x, row } of places) drawEntry(context, entry, theme, x, 28 + 16 * row);
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.drawImage(source, 0, Math.round(head * ratio));
  return canvas;
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {any[]} entries
 * @param {number} width
 */
function layOut(context, entries, width) {
  let x = 6;
  let row = 0;
  return entries.map((entry) => {
    const length = 28 + context.measureText(entry.label).width + 14;
    if (x + length > width && x > 6) {
      x = 6;
      row += 1;
    }
    const place = { entry, x, row };
    x += length;
    return place;
  });
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {any} entry
 * @param {import("./theme.js").Theme} theme
 * @param {number} x
 * @param {number} y
 */
function drawEntry(context, entry, theme, x, y) {
  context.strokeStyle = theme.colour(entry.colour);
  context.fillStyle = theme.colour(entry.colour);
  context.lineWidth = Math.max(1.5, entry.width ?? 1.5);
  if (entry.line !== false) {
    context.setLineDash(entry.dash ?? []);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + 22, y);
    context.stroke();
    context.setLineDash([]);
  }
  if (entry.marker) drawMarker(context, entry.marker, x + 11, y);
  context.fillStyle = theme.colour("ink");
  context.fillText(entry.label, x + 27, y);
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {import("./plot.js").Marker} marker
 * @param {number} x
 * @param {number} y
 */
function drawMarker(context, marker, x, y) {
  context.beginPath();
  if (marker === "cross") {
    context.moveTo(x - 3, y - 3);
    context.lineTo(x + 3, y + 3);
    context.moveTo(x + 3, y - 3);
    context.lineTo(x - 3, y + 3);
    context.stroke();
    return;
  }
  if (marker === "square") context.rect(x - 3, y - 3, 6, 6);
  else if (marker === "triangle") {
    context.moveTo(x, y - 4);
    context.lineTo(x + 4, y + 3);
    context.lineTo(x - 4, y + 3);
  } else context.arc(x, y, 3, 0, 2 * Math.PI);
  context.fill();
}
