// @ts-check
/** The map as files: CSV with a row a cell, PNG as it is seen. */

import { csv, download, downloadCsv, fileName } from "../export.js";
import { dateTime, isoUtc } from "../format.js";
import { png } from "./picture.js";
import { sameAxes } from "./values.js";
import { observedWords } from "./versions.js";

/**
 * What is seen.
 * @typedef {object} Seen
 * @property {string} device
 * @property {import("./values.js").LookupMap} map
 * @property {import("./values.js").LookupMap | null} reference
 * @property {import("../heatmap.js").Picture} picture
 * @property {string} title
 * @property {number} read_ms when the map was read
 * @property {(f: number, i: number) => import("./words.js").CellNumbers} numbers
 * @property {import("../heatmap.js").Point[]} trail
 * @property {boolean} on
 * @property {import("../heatmap.js").Limits | null} limits
 */

/** @param {Seen} seen */
const nameOf = (seen) => [seen.device, `map-v${seen.map.version}`, seen.picture.quantity.id];

/** A row a cell, below two lines of remarks: `numpy.genfromtxt(…, skip_header=2, names=True)`. @param {Seen} seen */
export function saveCsv(seen) {
  const { map } = seen;
  const reference = seen.reference && sameAxes(map, seen.reference) ? seen.reference.version : "none";
  const head = ["f_sw_hz", "i_a", "r_ohm", "l_h", "power_w", "sigma_r_pct", "sigma_l_pct", "observed", "confidence", "age_s", "r_difference_pct", "l_difference_pct"];
  const rows = map.f_sw_hz.flatMap((_, f) => map.i_a.map((_, i) => Object.values(seen.numbers(f, i))));
  const remarks = [
    `lookup of ${seen.device}, version ${map.version} (${map.state}); differences to version ${reference}`,
    `read ${isoUtc(seen.read_ms)}, saved ${isoUtc(Date.now())}`,
  ];
  downloadCsv(fileName(nameOf(seen), Date.now(), "csv"), csv(remarks, head, rows));
}

/** @param {Seen} seen @param {import("../theme.js").Theme} theme */
export async function savePng(seen, theme) {
  const colours = { paper: theme.colour("paper"), ink: theme.colour("ink"), quiet: theme.colour("ink2") };
  const lines = [`${seen.device}: ${seen.title}`, observedWords(seen.map), dateTime(Date.now())];
  const { picture, trail, on, limits } = seen;
  download(fileName(nameOf(seen), Date.now(), "png"), await png({ picture, lines, trail, on, limits, dark: theme.dark, colours }));
}
