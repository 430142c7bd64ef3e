// @ts-check
/** Header and navigation: chosen device, connection, what this page heats, theme, Off. */

import { h, setAttribute, setText } from "./dom.js";
import { clock, duration, watt, words } from "./format.js";
import { hashOf, VIEWS } from "./router.js";

export class Header {
  /**
   * @param {HTMLElement} root
   * @param {HTMLElement} nav
   * @param {{stream: import("./stream.js").Stream, fleet: import("./fleet.js").Fleet,
   *   leases: import("./leases.js").Leases, theme: import("./theme.js").Theme,
   *   off: import("./off.js").Off, choose: (device: string) => void, logout: (() => void) | null,
   *   device: () => string}} parts
   */
  constructor(root, nav, parts) {
    this.parts = parts;
    this.chooser = h("select", { id: "device", "aria-label": "Device", data: { testid: "device-chooser" }, on: { change: () => parts.choose(this.chooser.value) } });
    // The seconds are not read out: they change.
    this.staleSince = h("span", {});
    this.staleFor = h("span", { "aria-hidden": "true" });
    this.stale = h("span", { class: "stale", role: "status", hidden: true, data: { testid: "stale" } }, this.staleSince, this.staleFor);
    this.skipped = h("span", { class: "skipped quiet", hidden: true, data: { testid: "skipped" } });
    this.missed = h("span", { class: "quiet", hidden: true, title: "this browser was too slow for them; the journal has them all" });
    this.heating = h("span", { class: "heating", hidden: true, data: { testid: "heating" } });
    this.offButton = h("button", { type: "button", class: "off", data: { testid: "off" }, title: "Switches the chosen device off, and whatever else this page heats (Esc)", on: { click: () => parts.off.press(parts.device()) } },
      "Off ", h("kbd", {}, "Esc"));
    root.replaceChildren(
      h("div", { id: "header-rest" },
        h("span", { class: "brand" }, "ihd"), this.chooser, this.stale, this.skipped, this.missed,
        h("span", { class: "grow" }), this.#themeChooser(),
        parts.logout ? h("button", { type: "button", class: "small", on: { click: parts.logout } }, "Log out") : null),
      this.heating, this.offButton);
    this.links = VIEWS.map((view) => h("a", { href: "#", hidden: view.edge === true, data: { view: view.name } }, view.label));
    nav.replaceChildren(...this.links);
    this.#listen();
    this.showDevices();
  }

  /** Views and device that are shown. @param {string} view @param {string} device */
  showPlace(view, device) {
    this.links.forEach((link, i) => {
      link.setAttribute("href", hashOf(VIEWS[i].name, device));
      setAttribute(link, "aria-current", VIEWS[i].name === view ? "page" : null);
    });
    this.showDevices();
    const known = VIEWS.find((candidate) => candidate.name === view);
    this.title = known ? `${known.label}${known.device && device ? ` ${device}` : ""}` : "ihd";
    this.#showTitle();
  }

  /** Shows the fleet's views if the daemon is an edge. @param {boolean} edge */
  showFleet(edge) {
    this.links.forEach((link, i) => {
      if (VIEWS[i].edge) link.hidden = !edge;
    });
  }

  /** Lists the devices with their states; without one there is nothing to choose. */
  showDevices() {
    const { fleet, device } = this.parts;
    // The chosen one stays where the daemon does not know it.
    const names = [...new Set([...fleet.names(), device()])].filter(Boolean);
    const known = [...this.chooser.options].map((option) => option.value);
    if (names.join("\n") !== known.join("\n")) {
      this.chooser.replaceChildren(...names.map((name) => h("option", { value: name }, name)));
    }
    for (const option of this.chooser.options) {
      const report = fleet.reports.get(option.value);
      const text = `${option.value} · ${report ? words(report.state) : "not known"}`;
      if (option.text !== text) option.text = text;
    }
    this.chooser.hidden = names.length === 0;
    this.chooser.value = device();
  }

  #themeChooser() {
    const { theme } = this.parts;
    const select = h("select", { "aria-label": "Theme", class: "theme", data: { testid: "theme" }, on: { change: () => theme.set(select.value) } },
      h("option", { value: "auto" }, "auto"), h("option", { value: "light" }, "light"), h("option", { value: "dark" }, "dark"));
    select.value = theme.mode;
    return select;
  }

  #listen() {
    const { stream, leases } = this.parts;
    stream.on("state", () => this.#showStale());
    setInterval(() => this.#showStale(), 1000);
    stream.frame("devices", () => this.showDevices());
    leases.on(() => this.#showHeating());
    let skipped = 0;
    let skippedAt = 0;
    stream.on("telemetry", (event) => {
      const now = Math.max(0, ...Object.values(event.devices).map((/** @type {any} */ one) => one.skipped));
      if (now > 0) {
        skipped += now;
        skippedAt = performance.now();
        this.skipped.hidden = false;
        setText(this.skipped, `link slow: ${skipped} intervals merged`);
      } else if (!this.skipped.hidden && performance.now() - skippedAt > 5000) {
        this.skipped.hidden = true;
        skipped = 0;
      }
    });
    let missed = 0;
    stream.on("missed", (event) => {
      missed += event.missed;
      this.missed.hidden = false;
      setText(this.missed, `${missed} events missed`);
    });
    addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || event.defaultPrevented) return;
      const box = event.target;
      if (box instanceof HTMLInputElement && box.type === "search" && box.value) {
        box.value = "";
        box.dispatchEvent(new Event("input"));
      } else this.parts.off.press(this.parts.device());
    });
  }

  #showStale() {
    const { stale, silent_since_ms } = this.parts.stream.state;
    this.stale.hidden = !stale;
    document.body.classList.toggle("is-stale", stale);
    if (!stale) return;
    const since = (performance.now() - silent_since_ms) / 1000;
    setText(this.staleSince, `stale since ${clock(Date.now() - since * 1000)}`);
    setText(this.staleFor, `: nothing heard for ${duration(Math.round(since))}`);
  }

  #showHeating() {
    const { leases } = this.parts;
    const heated = leases.heated();
    this.heating.hidden = heated.length === 0;
    const each = heated.map((name) => `${name} ${watt(leases.state(name).power_w)}`);
    const text = `this page heats ${heated.length > 3 ? `${heated.length} devices` : each.join(", ")}`;
    setText(this.heating, heated.length === 0 ? "" : text);
    this.heating.title = each.join(", ");
    this.#showTitle();
  }

  #showTitle() {
    document.title = `${this.parts.leases.heated().length ? "♨ " : ""}${this.title} · ihd`;
  }

  title = "Devices";
}
