// @ts-check
/** Recordings of a device: what begins one and what it holds, the one under way, and the files that there are. */

import { act, mayNot } from "../acting.js";
import { append, h, setAttribute, setText } from "../dom.js";
import { duration } from "../format.js";
import { Files } from "../recording/files.js";
import { fileOf, QUANTITIES, settings, triggerWords, words } from "../recording/settings.js";

/** @typedef {import("../context.js").Context} Context */
/** @typedef {{settings: import("../recording/settings.js").Settings, file: string | null, since_s: number}} RecordingNow */

/** @param {HTMLElement} root @param {Context} context */
export function mount(root, context) {
  const view = new RecordingsView(root, context);
  return { unmount: () => view.unmount() };
}

class RecordingsView {
  /** @param {HTMLElement} root @param {Context} context */
  constructor(root, context) {
    this.context = context;
    this.device = context.device;
    this.busy = false;
    this.heard_ms = performance.now();
    this.files = new Files(context);
    this.build(root);
    const { stream } = context;
    this.ends = [
      stream.on("devices", () => this.heard()),
      stream.on("notice", (notice) => notice.event === "recording" && this.files.load()),
      stream.on("gap", () => this.files.load()),
    ];
    this.clock = setInterval(() => this.tick(), 500);
    this.heard();
    this.files.load();
  }

  unmount() {
    clearInterval(this.clock);
    for (const end of this.ends) end();
    this.files.stop();
  }

  /** @param {HTMLElement} root */
  build(root) {
    this.cannot = mayNot(this.context);
    this.state = h("p", { class: "recordings-now", role: "status" });
    this.elapsed = h("span", { class: "recordings-elapsed number" });
    this.toggle = h("button", { type: "button", class: "strong recordings-toggle", data: { testid: "record-toggle" }, on: { click: () => this.press() } });
    this.problem = h("p", { class: "bad", role: "alert", id: "recordings-problem", hidden: true });
    this.will = h("p", { class: "quiet", id: "recordings-will" });
    append(root, [
      h("h1", null, "Recordings"),
      h(
        "section",
        { class: "panel recordings-panel", "aria-label": `Recording of ${this.device || "no device"}` },
        h("h2", null, this.device ? `Record ${this.device}` : "There is no device to record"),
        this.device ? this.form() : null,
        this.device ? h("div", { class: "recordings-act" }, this.toggle, this.elapsed, this.state) : null,
        this.problem,
        this.will,
      ),
      this.files.elements,
    ]);
  }

  form() {
    const choice = (/** @type {string} */ value, /** @type {string} */ text) => {
      const input = h("input", { type: "radio", name: "recordings-on", value, checked: value === "now", on: { change: () => this.changed() } });
      return h("label", { class: "recordings-radio" }, input, text);
    };
    const input = (/** @type {string} */ value, /** @type {string} */ placeholder = "") =>
      h("input", { type: "text", inputmode: "decimal", size: "6", value, placeholder, autocomplete: "off", "aria-describedby": "recordings-problem", on: { input: () => this.changed() } });
    this.quantity = h("select", { "aria-label": "Quantity", on: { change: () => this.changed() } }, QUANTITIES.map((q) => h("option", { value: q.id }, q.name)));
    this.direction = h("select", { "aria-label": "Direction", on: { change: () => this.changed() } }, h("option", { value: "rising" }, "rises above"), h("option", { value: "falling" }, "falls below"));
    this.level = input("1000");
    this.level.setAttribute("aria-label", "Level");
    this.unit = h("span", null, "W");
    this.levelBox = h("span", { class: "recordings-level" }, this.quantity, this.direction, this.level, this.unit);
    this.preTrigger = input("5");
    this.duration = input("", "until stopped");
    this.duration.setAttribute("size", "12");
    this.fields = h(
      "fieldset",
      { class: "recordings-form" },
      h("legend", { class: "unseen" }, "What is recorded"),
      h("div", { class: "recordings-trigger", role: "radiogroup", "aria-label": "Trigger" }, h("span", { class: "recordings-label" }, "Begins"), choice("now", "at once"), choice("fault", "when a fault trips"), choice("level", "when a level is crossed"), this.levelBox),
      h("label", { class: "recordings-number" }, h("span", { class: "recordings-label" }, "With what came before"), this.preTrigger, "s"),
      h("label", { class: "recordings-number" }, h("span", { class: "recordings-label" }, "Goes on for"), this.duration, "s"),
    );
    return this.fields;
  }

  /** What was filled in. */
  filled() {
    const on = this.fields.querySelector("input[type=radio]:checked")?.value ?? "now";
    return settings({
      on,
      quantity: this.quantity.value,
      level: this.level.value,
      direction: this.direction.value,
      preTrigger: this.preTrigger.value,
      duration: this.duration.value,
    });
  }

  changed() {
    if (!this.device) return;
    const on = this.fields.querySelector("input[type=radio]:checked")?.value;
    this.levelBox.hidden = on !== "level";
    setText(this.unit, QUANTITIES.find((q) => q.id === this.quantity.value)?.unit ?? "");
    const given = this.filled();
    const wrong = "problem" in given ? given : null;
    this.problem.hidden = !wrong || this.now !== null;
    setText(this.problem, wrong ? wrong.problem : "");
    for (const name of /** @type {const} */ (["level", "preTrigger", "duration"])) {
      setAttribute(this[name], "aria-invalid", wrong?.field === name ? "true" : null);
    }
    if (this.cannot) setText(this.will, this.cannot);
    else if (this.now) setText(this.will, "");
    else setText(this.will, "settings" in given ? `${words(given.settings)} It goes into an MCAP file of the daemon's store; heating is not touched.` : "");
    this.showToggle();
  }

  /** @type {RecordingNow | null} */
  now = null;

  heard() {
    const report = this.context.fleet.reports.get(this.device);
    this.heard_ms = performance.now();
    const before = this.now;
    this.now = report?.recording_now ?? null;
    this.connected = report !== undefined && report.state !== "searching" && report.state !== "incompatible";
    if ((before === null) !== (this.now === null) || before?.file !== this.now?.file) this.files.load();
    this.changed();
    this.tick();
  }

  showToggle() {
    const now = this.now;
    if (this.fields) this.fields.disabled = now !== null || this.cannot !== "";
    setText(this.toggle, !now ? "Start recording" : now.file === null ? "Disarm" : "Stop recording");
    setAttribute(this.toggle, "aria-pressed", now ? "true" : "false");
    const wrong = !now && "problem" in this.filled();
    const why = this.cannot || (!now && !this.connected ? `${this.device} is not connected.` : wrong ? "Mend what is marked first." : "");
    this.toggle.disabled = this.busy || why !== "";
    setAttribute(this.toggle, "title", why || null);
    this.toggle.dataset.state = !now ? "idle" : now.file === null ? "armed" : "recording";
  }

  /** Elapsed time, between two reports. */
  tick() {
    const { now } = this;
    const waits = now !== null && now.file === null;
    if (this.device) {
      if (!now) setText(this.state, this.connected ? "" : `${this.device} is not connected: nothing can be recorded now.`);
      else if (waits) setText(this.state, `armed: begins ${triggerWords(now.settings.trigger)}`);
      else setText(this.state, `recording into ${fileOf(now.file)}${now.settings.duration_s === null ? "" : `, ${now.settings.duration_s} s in all`}`);
      const since = now ? now.since_s + (performance.now() - this.heard_ms) / 1000 : NaN;
      setText(this.elapsed, now && Number.isFinite(since) ? `${waits ? "◌" : "●"} ${duration(Math.floor(since))}` : "");
      this.elapsed.classList.toggle("bad", now !== null && !waits);
    }
    this.files.tick(this.now !== null);
  }

  async press() {
    const { context, device, now } = this;
    const given = this.filled();
    if (!now && "problem" in given) return;
    this.busy = true;
    this.showToggle();
    try {
      if (now) await act(context, device, { command: "record-stop" }, now.file === null ? "disarm the recording" : "stop the recording");
      else if ("settings" in given) await act(context, device, { command: "record-start", ...given.settings }, "start a recording");
    } finally {
      this.busy = false;
      this.showToggle();
      this.files.load();
    }
  }
}
