// @ts-check
/** Files that the browser makes: CSV and PNG. */

import { h } from "./dom.js";

/**
 * A field of CSV (RFC 4180). Text that a spreadsheet would take for a formula gets a leading quote mark.
 * @param {string | number | boolean | null | undefined} value
 * @returns {string}
 */
export function csvField(value) {
  if (value === null || value === undefined || value === "") return "";
  if (typeof value === "number") return Number.isFinite(value) ? String(value) : "";
  if (typeof value === "boolean") return String(value);
  const text = /^[=+\-@\t\r]/.test(value) ? `'${value}` : value;
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/**
 * A table as CSV, with remarks above it in lines that begin with `# `.
 * @param {string[]} remarks device, time, what it is
 * @param {string[]} head names with units: `t / s`
 * @param {Iterable<(string | number | boolean | null | undefined)[]>} rows
 * @returns {string}
 */
export function csv(remarks, head, rows) {
  const lines = remarks.map((remark) => `# ${remark.replaceAll(/[\r\n]+/g, " ")}`);
  lines.push(head.map(csvField).join(","));
  for (const row of rows) lines.push(row.map(csvField).join(","));
  return lines.join("\r\n") + "\r\n";
}

/**
 * A name for a file of parts that may hold anything.
 * @param {string[]} parts
 * @param {number} at_ms
 * @param {string} extension without the dot
 * @returns {string}
 */
export function fileName(parts, at_ms, extension) {
  const stem = parts.map((part) => part.replaceAll(/[^A-Za-z0-9_]+/g, "-").replaceAll(/^-+|-+$/g, "")).filter(Boolean).join("-");
  const when = new Date(at_ms).toISOString().slice(0, 19).replaceAll(/[-:]/g, "");
  return `${stem}-${when}Z.${extension}`;
}

/**
 * Hands a file to the person.
 * @param {string} name
 * @param {Blob} blob
 */
export function download(name, blob) {
  const url = URL.createObjectURL(blob);
  const link = h("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(url), 30_000);
}

/**
 * @param {string} name
 * @param {string} text
 */
export function downloadCsv(name, text) {
  download(name, new Blob([text], { type: "text/csv;charset=utf-8" }));
}
