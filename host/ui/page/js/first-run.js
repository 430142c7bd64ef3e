// @ts-check
/** What a person does where no device is there: steps with a board and without one, each with what to type. */

import { h } from "./dom.js";
import { hashOf } from "./router.js";

/** A simulated hob in the daemon's configuration (docs/daemon.md). */
const SIMULATED = '[[device]]\nname = "simulated"\naddress = "sim"';

/**
 * @param {{announce: (text: string) => void}} context
 * @returns {HTMLElement}
 */
export function firstRun({ announce }) {
  const command = (/** @type {string} */ text) => {
    const code = h("code", null, text);
    const copy = async () => {
      try {
        await navigator.clipboard.writeText(text);
        announce("Copied");
      } catch {
        // Beyond loopback without TLS a page may not write there: the keyboard may.
        getSelection()?.selectAllChildren(code);
        announce("Selected: copy it with Ctrl C");
      }
    };
    const button = h("button", { type: "button", class: "small", "aria-label": `Copy ${text}`, on: { click: copy } }, "Copy");
    return h("span", { class: "first-command" }, code, button);
  };
  const steps = (/** @type {string} */ title, /** @type {any[][]} */ ...all) =>
    h("section", { class: "panel" }, h("h2", null, title), h("ol", null, all.map((step) => h("li", null, step))));
  return h(
    "div",
    { class: "first-run", data: { testid: "first-run" } },
    steps(
      "With a board",
      ["Plug it into a USB port of the computer that the daemon runs on. It is shown here within seconds."],
      ["Not shown? In a terminal this checks cable, rights, driver and firmware, and says what to do:", command("ihd doctor")],
      ["Then choose it, open Live and set a power. Nothing heats before that."],
    ),
    steps(
      "Without a board",
      ["For a look: a simulated hob that heats, on a page of its own that opens by itself.", command("ihd trainer --ui")],
      ["Or a simulated hob on this page: add this to the daemon's ihd.toml.", command(SIMULATED)],
      ["Start the daemon again: ^C where it runs, then", command("ihd trainer --daemon"), "This page finds it again by itself."],
    ),
  );
}

/**
 * What a view of one device shows where the daemon does not know it.
 * @param {HTMLElement} root
 * @param {string} title of the view
 * @param {string} device empty where there is none at all
 */
export function noDevice(root, title, device) {
  const [says, link] = device ? [`${device} is not known to the daemon. `, "Devices"] : ["No device is there yet. ", "How to begin"];
  root.append(h("h1", {}, title), h("p", {}, says, h("a", { href: hashOf("devices", "") }, link)));
}
