// @ts-check
/** Choices whose options change while the page is open. */

import { h } from "./dom.js";

/** Options of a choice, where they are others: a list that is open stays. @param {HTMLSelectElement} select @param {[string, string][]} options */
export function fill(select, options) {
  const now = [...select.options].map((option) => `${option.value} ${option.text}`).join("\n");
  if (now === options.map(([value, text]) => `${value} ${text}`).join("\n")) return;
  select.replaceChildren(...options.map(([value, text]) => h("option", { value }, text)));
}
