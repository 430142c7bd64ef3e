// @ts-check
/** A question with answers. Off in the header stays within reach, also by a screen reader: all else is inert meanwhile, and the dialog is not `aria-modal`. */

import { h } from "./dom.js";

/** Parts of the page that a question covers. Off and the alarms are in none of them. */
const COVERED = [".skip", "#main", "#views", "#header-rest"];

let number = 0;

/**
 * @param {import("./context.js").Question} question
 * @returns {Promise<string | null>} the answer's value; null where it was cancelled
 */
export function ask(question) {
  return new Promise((resolve) => {
    const before = /** @type {HTMLElement | null} */ (document.activeElement);
    const id = `question-${(number += 1)}`;
    const covered = COVERED.map((selector) => document.querySelector(selector)).filter((element) => element !== null);
    const close = (/** @type {string | null} */ value) => {
      removeEventListener("keydown", key, true);
      for (const element of covered) element.removeAttribute("inert");
      layer.remove();
      before?.focus?.();
      resolve(value);
    };
    const key = (/** @type {KeyboardEvent} */ event) => {
      if (event.key !== "Escape") return;
      // It is none of Off's.
      event.preventDefault();
      close(null);
    };
    const buttons = question.answers.map((answer) =>
      h("button", { type: "button", class: answer.danger ? "danger" : "strong", data: { answer: answer.value }, on: { click: () => close(answer.value) } }, answer.label));
    const cancel = h("button", { type: "button", data: { answer: "cancel" }, on: { click: () => close(null) } }, "Cancel");
    const box = h("div", { class: "question", role: "dialog", "aria-labelledby": `${id}-title`, "aria-describedby": `${id}-text`, tabindex: "-1" },
      h("h2", { id: `${id}-title` }, question.title),
      h("p", { id: `${id}-text` }, question.text),
      question.input ?? null,
      h("div", { class: "answers" }, cancel, buttons));
    const layer = h("div", { class: "question-layer" }, box);
    for (const element of covered) element.setAttribute("inert", "");
    addEventListener("keydown", key, true);
    document.body.append(layer);
    (/** @type {any} */ (question.input)?.querySelector?.("input, select, textarea") ?? cancel).focus();
  });
}
