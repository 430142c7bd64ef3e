// @ts-check
/** What is seen of a plot as a table, in the units of its axes. */

import { isoUtc } from "./format.js";

/**
 * @param {{options: import("./plot.js").PlotOptions, data: any[][], seen: () => import("./plot.js").View}} plot
 * @returns {{remarks: string[], head: string[], rows: any[][]}}
 */
export function tableOf(plot) {
  const { x, axes, series, table } = plot.options;
  const { from, to } = plot.seen();
  if (table) {
    const own = table();
    return { ...own, rows: own.rows.filter((row) => row[0] >= from && row[0] <= to) };
  }
  const axisOf = (/** @type {import("./plot.js").PlotSeries} */ one) => axes.find((axis) => axis.key === one.axis);
  const head = [x.time ? "time (UTC)" : `${x.label} / ${x.unit}`, ...series.map((one) => `${one.label} / ${axisOf(one)?.unit ?? ""}`)];
  const factors = series.map((one) => axisOf(one)?.factor ?? 1);
  const rows = [];
  for (let k = 0; k < plot.data[0].length; k += 1) {
    const at = plot.data[0][k];
    if (at < from || at > to) continue;
    const values = factors.map((factor, i) => (plot.data[i + 1][k] == null ? null : plot.data[i + 1][k] * factor));
    rows.push([x.time ? isoUtc(at * 1000) : at * (x.factor ?? 1), ...values]);
  }
  return { remarks: [], head, rows };
}
