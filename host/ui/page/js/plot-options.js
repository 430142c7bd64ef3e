// @ts-check
/** From a plot's own words to uPlot's. */

import { axisValues, decadeValues, TIME_STEPS, timeValues } from "./axes.js";
import { markerPaths } from "./plot-markers.js";

/** Room of an axis, in CSS pixels: equal for all, so that plots below each other line up. */
const AXIS_SIZE = 58;
const AXIS_SIZE_NARROW = 46;

/** Below this width a plot is drawn with narrow axes. */
const NARROW = 480;

/**
 * @param {number} width of the plot, in CSS pixels
 * @returns {number}
 */
export function axisSize(width) {
  return width < NARROW ? AXIS_SIZE_NARROW : AXIS_SIZE;
}

/**
 * @param {import("./plot.js").PlotOptions} options
 * @param {number} width in CSS pixels
 * @param {number} height in CSS pixels
 * @param {{cursor: () => void, selected: (u: any) => void}} told
 */
export function uplotOptions(options, width, height, told) {
  const { theme, axes, series, x } = options;
  const ink = () => theme.colour("ink2");
  const grid = { stroke: () => theme.colour("grid"), width: 1 };
  const font = "11px system-ui, sans-serif";
  const size = axisSize(width);
  /** @type {Record<string, any>} */
  const scales = { x: { time: false, auto: false } };
  for (const axis of axes) scales[axis.key] = scaleOf(axis);
  return {
    width,
    height,
    legend: { show: false },
    padding: [8, axes.some((axis) => axis.side === "right") ? 4 : x.time ? 26 : 14, 0, 4],
    cursor: {
      drag: { x: true, y: false, setScale: false },
      // The cursor is shared, a selection is not: its owner tells the others.
      sync: options.sync ? { key: options.sync, setSeries: false, filters: { pub: moves } } : undefined,
      points: { size: 5 },
      bind: { dblclick: () => () => null },
    },
    scales,
    axes: [
      { scale: "x", stroke: ink, grid, ticks: { ...grid, size: 4 }, font, labelFont: font, size: 18, gap: 1,
        label: `${x.label} / ${x.unit}`, labelSize: 14, labelGap: 0, space: x.time ? 70 : 60, ...(x.time ? { incrs: TIME_STEPS } : {}),
        values: x.time ? timeValues : axisValues(x.factor ?? 1) },
      ...axes.map((axis, i) => ({
        scale: axis.key, side: axis.side === "right" ? 1 : 3, stroke: ink, font, labelFont: font, size,
        grid: i === 0 ? grid : { show: false }, ticks: { ...grid, size: 4 }, gap: 2, space: 24,
        label: `${axis.label} / ${axis.unit}`, labelSize: 14, labelGap: 0,
        values: axis.log ? decadeValues(axis.factor ?? 1) : axisValues(axis.factor ?? 1),
        ...(axis.log ? { filter: decades } : {}),
      })),
    ],
    series: [{}, ...series.map((one) => seriesOf(one, theme))],
    bands: (options.bands ?? []).map((band) => ({
      series: [band.high, band.low], fill: () => theme.colour(band.colour),
    })),
    hooks: {
      drawAxes: [(/** @type {any} */ u) => options.under?.forEach((draw) => clipped(u, () => draw(u, theme)))],
      draw: [(/** @type {any} */ u) => options.over?.forEach((draw) => clipped(u, () => draw(u, theme)))],
      setCursor: [told.cursor],
      setSelect: [told.selected],
    },
  };
}

/** @param {string} type of a pointer's event */
function moves(type) {
  return type === "mousemove" || type === "mouseleave" || type === "mouseenter";
}

/** @param {import("./plot.js").PlotAxis} axis */
function scaleOf(axis) {
  const own = axis.range;
  return {
    ...(axis.log ? { distr: 3 } : {}),
    ...(own ? { range: (/** @type {any} */ _u, /** @type {number} */ least, /** @type {number} */ most) => own(least, most) } : {}),
  };
}

/**
 * @param {import("./plot.js").PlotSeries} one
 * @param {import("./theme.js").Theme} theme
 */
function seriesOf(one, theme) {
  const stroke = () => theme.colour(one.colour);
  return {
    label: one.label,
    scale: one.axis,
    show: !one.hidden,
    stroke: one.band ? () => "transparent" : stroke,
    width: one.band ? 0 : (one.width ?? 1.25),
    dash: one.dash,
    paths: one.line === false ? () => null : undefined,
    points: one.marker ? { show: true, size: 6, stroke, fill: stroke, paths: markerPaths(one.marker) } : { show: false },
  };
}

/**
 * Values of decades alone on a logarithmic axis.
 * @param {any} _u
 * @param {number[]} splits
 */
function decades(_u, splits) {
  return splits.map((value) => (Math.abs(Math.log10(value) - Math.round(Math.log10(value))) < 1e-6 ? value : null));
}

/**
 * Runs a drawing within the plot's area.
 * @param {any} u
 * @param {() => void} draw
 */
function clipped(u, draw) {
  const { left, top, width, height } = u.bbox;
  u.ctx.save();
  u.ctx.beginPath();
  u.ctx.rect(left, top, width, height);
  u.ctx.clip();
  draw();
  u.ctx.restore();
}
