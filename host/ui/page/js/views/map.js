// @ts-check
/** The lookup as a map over switching frequency and current: what the controller believes, and where it works. */

import { mayNot } from "../acting.js";
import { append, h, setAttribute, setText } from "../dom.js";
import { dateTime } from "../format.js";
import { Heatmap } from "../heatmap.js";
import { Bar, legend } from "../map/bar.js";
import { Readout } from "../map/readout.js";
import { saveCsv, savePng } from "../map/saving.js";
import { Tools } from "../map/tools.js";
import { asMap, coordinate, lowestAllowed, QUANTITIES, quantity, sameAxes, scaleOf, values } from "../map/values.js";
import { observedWords, pushButton, versions } from "../map/versions.js";
import { cellWords } from "../map/words.js";
import { Newest } from "../newest.js";

/** Points of the working point's trail: so many seconds at ten a second. */
const TRAIL_POINTS = 100;

/** Results come several times a second; ages and deviations are read again this often at most, in milliseconds. */
const AGAIN_MS = 4000;

/** @typedef {import("../context.js").Context} Context */
/** @typedef {import("../map/values.js").LookupMap} LookupMap */

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
  const view = new MapView(root, context);
  return { unmount: () => view.unmount() };
}

class MapView {
  /** @type {(() => void)[]} */
  ends = [];
  /** @type {Heatmap} */
  heatmap;
  /** @type {Bar} */
  bar;
  /** @type {Readout} */
  readout;
  /** @type {Tools} */
  tools;
  /** @type {import("../map/versions.js").Versions} */
  table;

  /** @param {HTMLElement} root @param {Context} context */
  constructor(root, context) {
    this.context = context;
    this.device = context.device;
    /** @type {LookupMap | null} what the device uses */
    this.own = null;
    /** @type {LookupMap | null} */
    this.shown = null;
    /** @type {LookupMap | null} */
    this.reference = null;
    /** @type {any[]} */
    this.rows = [];
    /** @type {number | null} version that is shown; null for that of the device */
    this.wanted = null;
    this.against = 0;
    this.quantity = quantity("r");
    /** @type {[number, number]} */
    this.cell = [0, 0];
    /** The numbers are those of the working point's cell until a person chooses another one. */
    this.follows = true;
    /** @type {import("../heatmap.js").Point[]} */
    this.trail = [];
    this.on = false;
    this.read_ms = 0;
    this.asked_ms = -Infinity;
    this.listWanted = true;
    this.timer = 0;
    this.stop = new AbortController();
    this.reads = new Newest(() => this.read(), (why) => this.failed(why));
    this.build(root);
    this.subscribe();
    this.load();
  }

  unmount() {
    this.reads.stop();
    this.stop.abort();
    clearTimeout(this.timer);
    clearInterval(this.ageTimer);
    for (const end of this.ends) end();
    this.heatmap.destroy();
  }

  /** @param {HTMLElement} root */
  build(root) {
    const { context } = this;
    this.heading = h("h1", null, `Map of ${this.device}`);
    this.version = h("span", { class: "map-version", data: { testid: "lookup-version" } });
    this.tools = new Tools({
      quantity: (id) => {
        this.quantity = quantity(id);
        this.paint();
      },
      version: (version) => {
        this.wanted = version;
        this.load();
      },
      reference: (version) => this.compare(version),
      save: (kind) => this.save(kind),
    });
    this.state = h("p", { class: "map-state", role: "status" }, "Reading the map …");
    this.caption = h("p", { class: "map-title" });
    this.area = h("div", { class: "map-area" });
    this.heatmap = new Heatmap(this.area, {
      theme: context.theme,
      inspect: (cell) => {
        if (!cell) return;
        this.cell = cell;
        this.follows = false;
        this.readOut();
      },
    });
    this.bar = new Bar(context.theme);
    this.picked = h("p", { class: "map-picked", data: { testid: "map-picked" } });
    this.readout = new Readout();
    const view = {
      show: (/** @type {number} */ version) => this.show(version),
      compare: (/** @type {number} */ version) => this.compare(version),
      map: (/** @type {number} */ version) => this.fetchMap(version),
      current: () => this.own,
      changed: () => this.load(),
    };
    this.table = versions(context, view);
    const cannot = mayNot(context);
    this.content = h(
      "div",
      { class: "map-content", hidden: true },
      this.caption,
      this.area,
      h("div", { class: "map-below" }, this.bar.element, this.picked, legend()),
      this.readout.element,
      h("div", { class: "map-heading" }, h("h2", null, "Versions"), pushButton(context, view)),
      cannot ? h("p", { class: "quiet" }, cannot) : null,
      this.table.element,
    );
    append(root, [
      h("div", { class: "map-heading" }, this.heading, this.version),
      this.tools.element,
      this.state,
      this.content,
    ]);
  }

  subscribe() {
    const { stream, theme } = this.context;
    this.ends = [
      stream.frame("telemetry", (event) => this.work(event.devices[this.device])),
      stream.on("notice", (notice) => this.noticed(notice)),
      stream.on("gap", () => this.load()),
      stream.on("devices", () => this.tellVersion()),
      theme.on(() => {
        this.heatmap.repaint();
        this.drawBar();
      }),
    ];
    this.ageTimer = setInterval(() => this.quantity.id === "age" && this.paint(), 10_000);
  }

  /** @param {any} notice */
  noticed(notice) {
    if (notice.device !== this.device) return;
    if (notice.event === "lookup-active" || notice.event === "lookup-refused") this.load();
    else if (notice.event === "result-stored") this.loadSoon();
  }

  loadSoon() {
    if (this.timer) return;
    this.timer = setTimeout(
      () => {
        this.timer = 0;
        if (!document.hidden) this.load(false);
      },
      Math.max(AGAIN_MS - (performance.now() - this.asked_ms), 0),
    );
  }

  /** @param {number | null} version null for that of the device @returns {Promise<LookupMap>} */
  fetchMap(version) {
    const { api } = this.context;
    return api.get(api.path(["devices", this.device, "map"], { version }), { signal: this.stop.signal }).then(asMap);
  }

  /** What the device uses; null where nobody knows, as before it was first connected. @returns {Promise<LookupMap | null>} */
  async fetchOwn() {
    try {
      return await this.fetchMap(null);
    } catch (why) {
      if (/** @type {any} */ (why)?.error === "no-version") return null;
      throw why;
    }
  }

  /** @param {boolean} versions the list of versions too, which grows for months */
  load(versions = true) {
    this.listWanted ||= versions;
    this.reads.ask(null);
  }

  /** Reads everything that is shown. */
  async read() {
    const { api } = this.context;
    this.asked_ms = performance.now();
    const read_ms = Date.now();
    const listed = this.listWanted;
    this.listWanted = false;
    const lookups = listed ? api.get(api.path(["devices", this.device, "lookups"]), { signal: this.stop.signal }) : this.rows;
    const [own, rows] = await Promise.all([this.fetchOwn(), lookups]);
    // Another version than those that are listed: its notice was missed.
    if (own && own.version !== 0 && !rows.some((/** @type {any} */ row) => row.version === own.version && row.state === "active") && !listed) this.load();
    const other = (/** @type {number | null} */ version) =>
      own && (version === null || version === own.version) ? own : this.fetchMap(version ?? 0);
    const [shown, reference] = await Promise.all([other(this.wanted), other(this.against)]);
    if (this.stop.signal.aborted) return;
    Object.assign(this, { own, rows, shown, reference, read_ms });
    this.state.hidden = true;
    this.content.hidden = false;
    this.tell();
  }

  /** @param {any} why */
  failed(why) {
    this.listWanted = true;
    this.state.hidden = false;
    const again = h("button", { type: "button", on: { click: () => this.load() } }, "Try again");
    const gone = why?.error === "no-version";
    if (gone) [this.wanted, this.against] = [null, 0];
    this.state.replaceChildren(`The map cannot be read: ${why?.message ?? why}. ${this.shown ? "What is shown is what was read last. " : ""}`, again);
  }

  tell() {
    this.showTools();
    this.tellVersion();
    if (this.shown) this.heatmap.limit(this.limits(this.shown));
    this.paint();
    this.table.show(this.rows, this.shown, this.reference, this.own?.version ?? null);
  }

  tellVersion() {
    const report = this.context.fleet.reports.get(this.device);
    const version = report?.lookup?.on_device ?? this.own?.version ?? null;
    const map = this.own && this.own.version === version ? this.own : null;
    const text = version === null ? "it is not known which version the device uses" : version === 0 ? "in use: version 0, built in" : `in use: version ${version}`;
    setText(this.version, map ? `${text} · ${observedWords(map)}` : text);
    setAttribute(this.version, "data-value", version === null ? null : String(version));
  }

  showTools() {
    const chosen = { quantity: this.quantity.id, version: this.wanted, reference: this.against };
    this.tools.show(this.rows.map((row) => row.version), this.own?.version ?? null, chosen);
  }

  /** @param {number} version */
  show(version) {
    this.wanted = version === this.own?.version ? null : version;
    this.context.announce(`Map of version ${version}`);
    this.load();
  }

  /** @param {number} version */
  compare(version) {
    this.against = version;
    if (this.quantity.scale !== "diverging") this.quantity = quantity("r-difference");
    this.showTools();
    this.context.announce(`Difference to version ${version}`);
    this.load();
  }

  /** @returns {import("../heatmap.js").Picture | null} */
  picture() {
    const map = this.shown;
    if (!map) return null;
    const older_s = Math.max(0, Date.now() - this.read_ms) / 1000;
    this.tables = Object.fromEntries(QUANTITIES.map((q) => [q.id, values(map, q.id, this.reference, older_s)]));
    const table = this.tables[this.quantity.id];
    const scale = scaleOf(this.quantity, table);
    return {
      f_sw_hz: map.f_sw_hz,
      i_a: map.i_a,
      quantity: this.quantity,
      values: table,
      observed: map.observed,
      scale,
      describe: (f, i) => cellWords(this.numbers(map, f, i), this.quantity, table[f][i]),
    };
  }

  /** @type {Record<string, (number | null)[][]>} every quantity of the map that is shown */
  tables = {};

  /** @param {LookupMap} map @param {number} f @param {number} i @returns {import("../map/words.js").CellNumbers} */
  numbers(map, f, i) {
    const of = (/** @type {import("../map/values.js").QuantityId} */ id) => this.tables[id][f][i];
    return {
      f_sw_hz: map.f_sw_hz[f],
      i_a: map.i_a[i],
      r_ohm: of("r"),
      l_h: of("l"),
      power_w: of("power"),
      sigma_r_pct: of("r-sigma"),
      sigma_l_pct: of("l-sigma"),
      observed: map.observed[f]?.[i] === true,
      confidence: of("confidence"),
      age_s: of("age"),
      r_difference_pct: of("r-difference"),
      l_difference_pct: of("l-difference"),
    };
  }

  paint() {
    const picture = this.picture();
    if (!picture || !this.shown) return;
    this.now = picture;
    const { version, state, at_ms, why } = this.shown;
    const history = version === 0 ? "built in" : [state, at_ms ? `since ${dateTime(at_ms)}` : "", why].filter(Boolean).join(", ");
    const meaning = this.quantity.id.endsWith("-sigma") ? "two times in three the truth lies within ± σ · " : "";
    this.caption.replaceChildren(h("strong", null, this.titleText()), ` · ${meaning}${history}`);
    this.heatmap.show(picture, `${this.titleText()}: rows are switching frequencies, columns amplitudes of the current; arrow keys walk`);
    this.drawBar();
    this.readOut();
  }

  titleText() {
    const difference = this.quantity.scale === "diverging" ? ` to version ${this.reference?.version ?? this.against}` : "";
    return `${this.quantity.name}${difference}, version ${this.shown?.version}`;
  }

  drawBar() {
    if (!this.now) return;
    this.bar.show(this.now);
    const { empty } = this.now.scale;
    this.state.hidden = !empty;
    if (empty) this.state.replaceChildren(emptyWords(this.quantity.id, this.shown, this.reference));
  }

  readOut() {
    if (!this.shown) return;
    const [f, i] = [Math.min(this.cell[0], this.shown.f_sw_hz.length - 1), Math.min(this.cell[1], this.shown.i_a.length - 1)];
    const whose = this.follows && this.on ? "Cell at the working point" : "Chosen cell";
    this.readout.show(whose, this.numbers(this.shown, f, i), this.reference?.version ?? null);
    if (this.now) setText(this.picked, `${whose}: ${this.now.describe(f, i)}`);
  }

  /** @param {import("../telemetry.js").DeviceTelemetry | undefined} told */
  work(told) {
    const live = told?.last;
    if (!live) return;
    this.on = live.f_sw_hz > 0 && live.i_crest_a > 0;
    if (this.on) {
      this.trail.push({ f_sw_hz: live.f_sw_hz, i_a: live.i_crest_a });
      if (this.trail.length > TRAIL_POINTS) this.trail.shift();
      if (this.follows && this.shown) {
        const at = (/** @type {number[]} */ knots, /** @type {number} */ value, /** @type {boolean} */ log) =>
          Math.min(Math.max(Math.round(coordinate(knots, value, log)), 0), knots.length - 1);
        this.cell = [at(this.shown.f_sw_hz, live.f_sw_hz, true), at(this.shown.i_a, live.i_crest_a, false)];
        this.readOut();
      }
    }
    this.heatmap.work(this.trail, this.on);
  }

  /** @param {string} kind */
  async save(kind) {
    const { shown, now } = this;
    if (!shown || !now) return;
    const seen = {
      device: this.device,
      map: shown,
      reference: this.reference,
      picture: now,
      title: this.titleText(),
      read_ms: this.read_ms,
      numbers: (/** @type {number} */ f, /** @type {number} */ i) => this.numbers(shown, f, i),
      trail: this.trail,
      on: this.on,
      limits: this.limits(shown),
    };
    try {
      if (kind === "CSV") saveCsv(seen);
      else await savePng(seen, this.context.theme);
      this.context.announce(`The map was saved as ${kind}`);
    } catch (why) {
      this.context.complain(`The map cannot be saved as ${kind}`, why);
    }
  }

  /** @param {LookupMap} map @returns {import("../heatmap.js").Limits | null} */
  limits(map) {
    const { hob } = this.context;
    if (!hob) return null;
    return { f_min_hz: hob.f_sw_min_hz, f_max_hz: hob.f_sw_max_hz, i_max_a: hob.i_limit_a, lowest_hz: lowestAllowed(map, hob) };
  }
}

/** @param {string} id @param {LookupMap | null} map @param {LookupMap | null} reference */
function emptyWords(id, map, reference) {
  if (id === "confidence" || id.endsWith("-sigma")) {
    if (map?.version === 0) return "The built-in map is a guess: how far off it is for your pot, nobody knows.";
    return "How sure this version is is not known: it was pushed by hand, found on the device, or built by an earlier version of ihd.";
  }
  if (id === "age") return "Nothing of this map was learned since the daemon was started.";
  if (id.endsWith("-difference") && map && reference && !sameAxes(map, reference)) return "The two versions lie on different axes and cannot be compared.";
  return "No cell has a value.";
}
