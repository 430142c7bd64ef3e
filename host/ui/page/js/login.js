// @ts-check
/** Who may look and command: the session, and the form where a token is needed. */

import * as api from "./api.js";
import { h, setText } from "./dom.js";

/**
 * @returns {Promise<import("./context.js").Session | null>} null where a token is needed and missing
 */
export async function session() {
  try {
    return await api.get("session");
  } catch (why) {
    if (why instanceof api.ApiError && why.status === 401) return null;
    throw why;
  }
}

/**
 * Asks for the token until the daemon takes it.
 * @param {HTMLElement} root
 * @returns {Promise<void>}
 */
export function login(root) {
  return new Promise((resolve) => {
    const token = h("input", { id: "token", type: "password", autocomplete: "current-password", required: true, spellcheck: "false", data: { testid: "token" } });
    const button = h("button", { type: "submit", class: "strong" }, "Log in");
    const problem = h("p", { class: "bad", role: "alert" });
    const submit = async (/** @type {Event} */ event) => {
      event.preventDefault();
      button.disabled = true;
      try {
        await api.request("session", { method: "POST", body: { token: token.value.trim() } });
        resolve();
      } catch (why) {
        setText(problem, why instanceof Error ? why.message : String(why));
        button.disabled = false;
        token.select();
      }
    };
    root.replaceChildren(h("form", { class: "login", on: { submit } },
      h("h1", {}, "A token is needed"),
      h("p", {}, "It stands in the daemon's token file, a line ", h("code", {}, "role token"), " each: read looks, operate commands."),
      h("label", { for: "token" }, "Token"), token, button, problem));
    token.focus();
  });
}

/** Ends the session: the cookie goes. */
export function logout() {
  return api.request("session", { method: "DELETE" });
}
