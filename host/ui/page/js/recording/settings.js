// @ts-check
/** What a recording is asked for with, in the API's words and in a person's. */

/** @typedef {{on: "now"} | {on: "fault"} | {on: "level", quantity: string, level: number, rising: boolean}} Trigger */
/** @typedef {{trigger: Trigger, pre_trigger_s: number, duration_s: number | null}} Settings */

/** Quantities that a level can be set on, with the unit of the level and the range that makes sense. */
export const QUANTITIES = [
  { id: "power", name: "Power", unit: "W", low: 0, high: 10_000 },
  { id: "current", name: "Crest current", unit: "A", low: 0, high: 200 },
  { id: "resistance", name: "R", unit: "Ω", low: 0, high: 16 },
  { id: "inductance", name: "L", unit: "µH", low: 0, high: 64 },
  { id: "frequency", name: "Switching frequency", unit: "kHz", low: 0, high: 200 },
];

/** Longest time before the trigger that is recorded, in seconds. */
export const MAX_PRE_TRIGGER_S = 60;

/**
 * The settings of what was filled in, or what is wrong with it.
 * @param {{on: string, quantity: string, level: string, direction: string, preTrigger: string, duration: string}} form
 * @returns {{settings: Settings} | {field: string, problem: string}}
 */
export function settings(form) {
  const number = (/** @type {string} */ text) => (text.trim() === "" ? NaN : Number(text.replace(",", ".")));
  const pre_trigger_s = form.preTrigger.trim() === "" ? 0 : number(form.preTrigger);
  if (!(pre_trigger_s >= 0 && pre_trigger_s <= MAX_PRE_TRIGGER_S)) {
    return { field: "preTrigger", problem: `Seconds before the trigger must lie between 0 and ${MAX_PRE_TRIGGER_S}.` };
  }
  let duration_s = null;
  if (form.duration.trim() !== "") {
    duration_s = number(form.duration);
    if (!(duration_s > 0 && duration_s <= 86_400)) {
      return { field: "duration", problem: "Seconds after the trigger must lie above 0 and be 86 400 at most; leave it empty to stop by hand." };
    }
  }
  if (form.on !== "level") {
    return { settings: { trigger: { on: form.on === "fault" ? "fault" : "now" }, pre_trigger_s, duration_s } };
  }
  const of = QUANTITIES.find((q) => q.id === form.quantity) ?? QUANTITIES[0];
  const level = number(form.level);
  if (!(level >= of.low && level <= of.high)) {
    return { field: "level", problem: `The level of ${of.name} must lie between ${of.low} and ${of.high} ${of.unit}.` };
  }
  const trigger = /** @type {Trigger} */ ({ on: "level", quantity: of.id, level, rising: form.direction !== "falling" });
  return { settings: { trigger, pre_trigger_s, duration_s } };
}

/** A trigger in words. @param {Trigger | null | undefined} trigger */
export function triggerWords(trigger) {
  if (!trigger || trigger.on === "now") return "at once";
  if (trigger.on === "fault") return "when a fault trips";
  const of = QUANTITIES.find((q) => q.id === trigger.quantity);
  const unit = of ? ` ${of.unit}` : "";
  return `when ${of?.name ?? trigger.quantity} ${trigger.rising ? "rises above" : "falls below"} ${trigger.level}${unit}`;
}

/**
 * What a recording with these settings does, in words.
 * @param {Settings} given
 */
export function words(given) {
  const before = given.pre_trigger_s > 0 ? `, with the ${given.pre_trigger_s} s before it` : "";
  const end = given.duration_s === null ? "until it is stopped" : `for ${given.duration_s} s`;
  return `Begins ${triggerWords(given.trigger)}${before}, and goes on ${end}.`;
}

/** A file's name without its folder. @param {string | null} path */
export const fileOf = (path) => (path ?? "").split(/[\\/]/).pop() ?? "";

/** The name that the daemon gives a download; null where it gives none. @param {string | null} disposition of its answer */
export function nameOf(disposition) {
  const name = /filename="?([^";]+)"?/.exec(disposition ?? "")?.[1];
  return name ? fileOf(name) : null;
}
