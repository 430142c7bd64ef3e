// @ts-check
/** The table of a device's lookups, and what can be done with each: look, compare, roll back, push a file, save. */

import { act, mayNot } from "../acting.js";
import { append, h, setText } from "../dom.js";
import { download, fileName } from "../export.js";
import { dateTime, fixed } from "../format.js";
import { MAX_FILE_BYTES, read, toBytes, toJson } from "./lookup-file.js";
import { change, observedCells } from "./values.js";
import { percent } from "./words.js";

/** @typedef {import("../context.js").Context} Context */
/** @typedef {import("./values.js").LookupMap} LookupMap */
/** @typedef {{version: number, state: string, at_ms: number, origin: string, why: string, blob: number[]}} StoredLookup */

/** Most versions in the table. */
const MAX_ROWS = 200;

/** What the words of the store mean, for people. */
const STATES = /** @type {Record<string, string>} */ ({
  active: "active",
  pending: "pending: on its way to the device",
  superseded: "superseded",
  refused: "refused by the device",
  prior: "built in",
});

const ORIGINS = /** @type {Record<string, string>} */ ({ host: "this host", device: "found on the device", firmware: "the firmware" });

/**
 * @typedef {object} Versions
 * @property {HTMLElement} element
 * @property {(rows: StoredLookup[], shown: LookupMap | null, reference: LookupMap | null, onDevice: number | null) => void} show
 */

/**
 * @param {Context} context
 * @param {{show: (version: number) => void, compare: (version: number) => void, map: (version: number) => Promise<LookupMap>,
 *   current: () => LookupMap | null, changed: () => void}} view
 * @returns {Versions}
 */
export function versions(context, view) {
  const body = h("tbody", null);
  const head = ["Version", "State", "Since", "From", "Why", "What can be done"];
  const table = h(
    "table",
    { class: "map-versions" },
    h("caption", { class: "unseen" }, "Lookups of the device, newest first"),
    h("thead", null, h("tr", null, head.map((text) => h("th", { scope: "col" }, text)))),
    body,
  );
  const older = h("p", { class: "map-older quiet", hidden: true });
  const element = h("div", { class: "map-scroll", tabindex: "0", role: "region", "aria-label": "Versions of the lookup" }, table, older);
  let drawn = "";
  return {
    element,
    show(rows, shown, reference, onDevice) {
      const all = withPrior(rows);
      const more = all.length - 1 - MAX_ROWS;
      older.hidden = more <= 0;
      setText(older, `${more} older versions are not listed; the choices above the map have them.`);
      if (more > 0) all.splice(MAX_ROWS, more);
      // A table that is drawn anew would lose the focus: only where something is another one.
      const now = JSON.stringify([all.map((r) => [r.version, r.state, r.at_ms]), shown?.version, reference?.version, onDevice, context.session.role]);
      if (now === drawn) return;
      drawn = now;
      const focused = /** @type {HTMLElement | null} */ (document.activeElement)?.dataset?.act;
      body.replaceChildren(...all.map((row) => line(context, view, row, { shown, reference, onDevice })));
      if (focused) body.querySelector(`[data-act="${focused}"]`)?.focus();
    },
  };
}

/** Newest first, the built-in one last. @param {StoredLookup[]} rows @returns {StoredLookup[]} */
function withPrior(rows) {
  const prior = { version: 0, state: "prior", at_ms: 0, origin: "firmware", why: "what every device begins with", blob: [] };
  return [...rows.filter((row) => row.version !== 0).sort((a, b) => b.version - a.version || b.at_ms - a.at_ms), prior];
}

/**
 * @param {Context} context
 * @param {Parameters<typeof versions>[1]} view
 * @param {StoredLookup} row
 * @param {{shown: LookupMap | null, reference: LookupMap | null, onDevice: number | null}} now
 */
function line(context, view, row, now) {
  const { version } = row;
  const used = version === now.onDevice;
  const button = (/** @type {string} */ what, /** @type {string} */ label, /** @type {() => void} */ does, properties = {}) =>
    h("button", { type: "button", data: { act: `${what}-${version}` }, "aria-label": `${label} version ${version}`, ...properties, on: { click: does } }, label);
  const pressed = (/** @type {LookupMap | null} */ map) => (map?.version === version ? "true" : "false");
  const cannot = mayNot(context) || cannotRollBack(row, used);
  return h(
    "tr",
    { class: used ? "map-used" : null },
    h("th", { scope: "row" }, String(version)),
    h("td", null, STATES[row.state] ?? row.state, used ? h("span", { class: "map-mark" }, "in use") : null),
    h("td", { class: "map-time" }, row.at_ms ? dateTime(row.at_ms) : "–"),
    h("td", null, ORIGINS[row.origin] ?? row.origin),
    h("td", { class: "map-why" }, row.why || "–"),
    h(
      "td",
      { class: "map-acts" },
      button("show", "Show", () => view.show(version), { "aria-pressed": pressed(now.shown) }),
      button("compare", "Compare", () => view.compare(version), { "aria-pressed": pressed(now.reference) }),
      version === 0
        ? null
        : button("roll", "Roll back …", () => rollBack(context, view, row), { disabled: cannot !== "", title: cannot || null }),
      button("json", "JSON", () => save(context, view, row, "json"), { title: "as ihd device DEV lookup show --json writes it" }),
      row.blob.length > 0
        ? button("bin", "BIN", () => save(context, view, row, "bin"), { title: "the bytes, as ihd device DEV lookup push takes them" })
        : null,
    ),
  );
}

/** @param {StoredLookup} row @param {boolean} used */
function cannotRollBack(row, used) {
  if (used) return "The device uses this version.";
  if (row.state === "refused") return "The device refused this version.";
  if (row.state === "pending") return "This version is on its way to the device.";
  return "";
}

/**
 * What a change of the lookup does, before it is made.
 * @param {LookupMap | null} from
 * @param {LookupMap} to
 */
export function changeWords(from, to) {
  if (!from) return "";
  const { cells, r_pct, l_pct } = change(from, to);
  const all = to.observed.flat().length;
  if (cells === 0) return `Its cells are those of version ${from.version}, which is in use.`;
  return `Against version ${from.version}, which is in use, ${cells} of ${all} cells change: R by up to ${percent(r_pct)}, L by up to ${percent(l_pct)}.`;
}

const AFTERWARDS =
  "The device checks it and takes it over between two half-cycles; heating goes on, and protection does not depend on it. " +
  "While the hob heats, the next window that teaches something makes a new lookup of everything that was learned, which replaces this one.";

/** @param {Context} context @param {Parameters<typeof versions>[1]} view @param {StoredLookup} row */
async function rollBack(context, view, row) {
  const device = context.device;
  let map;
  try {
    map = await view.map(row.version);
  } catch (why) {
    context.complain(`Version ${row.version} cannot be read`, why);
    return;
  }
  const paragraphs = [`${device} gets the cells of version ${row.version} under a new version.`, changeWords(view.current(), map), AFTERWARDS];
  const answer = await context.ask({
    title: `Roll ${device} back to version ${row.version}?`,
    text: paragraphs.filter(Boolean).join(" "),
    answers: [{ label: `Roll back to version ${row.version}`, value: "roll", danger: true }],
  });
  if (answer !== "roll") return;
  const done = await act(context, device, { command: "lookup-rollback", version: row.version }, "roll the lookup back");
  if (done) view.changed();
}

/** @param {Context} context @param {Parameters<typeof versions>[1]} view @param {StoredLookup} row @param {"json" | "bin"} kind */
async function save(context, view, row, kind) {
  try {
    const blob =
      kind === "bin"
        ? new Blob([new Uint8Array(row.blob)], { type: "application/octet-stream" })
        : new Blob([toJson(await view.map(row.version))], { type: "application/json" });
    download(fileName([context.device, `lookup-v${row.version}`], row.at_ms || Date.now(), kind), blob);
  } catch (why) {
    context.complain(`Version ${row.version} cannot be saved`, why);
  }
}

/**
 * Chooses a file and pushes it, after it was said what it changes.
 * @param {Context} context
 * @param {Parameters<typeof versions>[1]} view
 * @returns {HTMLElement} the button, with its hidden chooser
 */
export function pushButton(context, view) {
  const chooser = h("input", { type: "file", accept: ".json,.bin,application/json", hidden: true });
  const cannot = mayNot(context);
  const button = h(
    "button",
    { type: "button", disabled: cannot !== "", title: cannot || "a lookup-vN.bin of ihd trainer, or the JSON of lookup show --json", on: { click: () => chooser.click() } },
    "Push a file …",
  );
  chooser.addEventListener("change", async () => {
    const file = chooser.files?.[0];
    chooser.value = "";
    if (file) await pushFile(context, view, file);
  });
  const box = h("span", { class: "map-push" });
  append(box, [button, chooser]);
  return box;
}

/** @param {Context} context @param {Parameters<typeof versions>[1]} view @param {File} file */
async function pushFile(context, view, file) {
  const device = context.device;
  const current = view.current();
  if (!current) return context.complain("The device's own map is not known yet: wait until it is shown");
  let lookup;
  let bytes;
  try {
    if (file.size > MAX_FILE_BYTES) throw new Error(`It has ${file.size} bytes; a lookup has less than ${MAX_FILE_BYTES}.`);
    lookup = read(new Uint8Array(await file.arrayBuffer()), { f_sw_hz: current.f_sw_hz, i_a: current.i_a });
    bytes = toBytes(lookup);
  } catch (why) {
    return context.complain(`${file.name} is not pushed`, why);
  }
  const map = { ...current, r_ohm: lookup.r_ohm, l_h: lookup.l_h, observed: lookup.observed, version: lookup.version };
  const text = [
    `${file.name} holds version ${lookup.version}, ${observedCells(map)} of ${map.observed.flat().length} cells known.`,
    changeWords(current, map),
    "It keeps its version where that is above the device's by 1000 at most, and gets a new one otherwise.",
    AFTERWARDS,
  ];
  const answer = await context.ask({
    title: `Push ${file.name} to ${device}?`,
    text: text.filter(Boolean).join(" "),
    answers: [{ label: "Push it", value: "push", danger: true }],
  });
  if (answer !== "push") return;
  const done = await act(context, device, { command: "lookup-push", blob: [...bytes] }, "push the lookup");
  if (done) view.changed();
}

/** How much of a map was observed, for its heading. @param {LookupMap} map */
export function observedWords(map) {
  const [seen, all] = [observedCells(map), map.observed.flat().length];
  return `${seen} of ${all} cells known (${fixed((100 * seen) / all, 0)}\u00a0%)`;
}
