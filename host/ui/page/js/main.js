// @ts-check
/** Start: session, limits, stream, header; then the view of the hash. */

import * as api from "./api.js";
import { ask } from "./dialog.js";
import { h, setText } from "./dom.js";
import { noDevice } from "./first-run.js";
import { Fleet } from "./fleet.js";
import { Header } from "./header.js";
import { Leases } from "./leases.js";
import { login, logout, session as readSession } from "./login.js";
import { Off } from "./off.js";
import { hashOf, placeOf, VIEWS } from "./router.js";
import { isShared } from "./shared-stream.js";
import { StoreBanner } from "./store-banner.js";
import { Stream } from "./stream.js";
import { LEAVE_MS, MAX_STREAMS, Tabs } from "./tabs.js";
import { Theme } from "./theme.js";

/** Between two intervals of the live stream, in milliseconds. */
const LIVE_MS = 200;
/** A daemon that was started just now may have its fleet so much later, in milliseconds. */
const FLEET_LATER_MS = 5000;

const main = /** @type {HTMLElement} */ (document.querySelector("#main"));
const alarms = /** @type {HTMLElement} */ (document.querySelector("#alarms"));
const announcer = /** @type {HTMLElement} */ (document.querySelector("#announce"));

/** @param {string} text */
function announce(text) {
  announcer.textContent = "";
  requestAnimationFrame(() => setText(announcer, text));
}

/**
 * An error that a person has to see, until he has.
 * @param {string} text
 * @param {unknown} [why]
 */
function complain(text, why) {
  const message = why instanceof Error ? `${text}: ${why.message}` : text;
  if ([...alarms.children].some((row) => /** @type {HTMLElement} */ (row).dataset.text === message)) return;
  const row = h("div", { class: "alarm", data: { text: message } }, message, " ", h("button", { type: "button", class: "small", on: { click: () => row.remove() } }, "Close"));
  while (alarms.childElementCount >= 5) (alarms.querySelector(".alarm:not(.off-alarm)") ?? alarms.firstElementChild)?.remove();
  alarms.append(row);
}

/** Session and limits; tries until the daemon answers. */
async function begin() {
  for (let wait_ms = 500; ; wait_ms = Math.min(5000, wait_ms * 1.6)) {
    try {
      let session = await readSession();
      while (!session) {
        await login(main);
        session = await readSession();
      }
      const [hob, reports] = await Promise.all([api.get("hob"), api.get("devices")]);
      return { session, hob, reports };
    } catch (why) {
      main.replaceChildren(h("p", { class: "bad", role: "alert" }, `${why instanceof Error ? why.message : why}; trying again …`));
      await new Promise((wake) => setTimeout(wake, wait_ms));
    }
  }
}

const theme = new Theme();
const { session, hob, reports } = await begin();
const stream = new Stream(api.address(`live?interval_ms=${LIVE_MS}`), { clock: api.daemonClock_ms });
const fleet = new Fleet(stream);
fleet.setReports(reports);
const leases = new Leases(stream, fleet, hob.lease_s);
const off = new Off({ fleet, stream, leases, alarms, announce, logIn });

/** Where the page is. */
let place = { view: "", device: "", isKnown: false };
/** @type {{unmount: () => void} | null} */
let mounted = null;
let visit = 0;

const header = new Header(
  /** @type {HTMLElement} */ (document.querySelector("#header")),
  /** @type {HTMLElement} */ (document.querySelector("#views")),
  {
    stream, fleet, leases, theme, off,
    device: () => place.device,
    choose: (device) => {
      const known = VIEWS.find((view) => view.name === place.view);
      if (known?.device) location.hash = hashOf(place.view, device);
      else go({ view: place.view, device });
    },
    logout: session.token_needed ? leave : null,
  },
);

/** Shows the way to the fleet where the daemon is an edge of one: asked anew of a daemon that may be another. */
async function lookForFleet() {
  const found = (await readSession().catch(() => null))?.fleet === true;
  header.showFleet(found);
  return found;
}
header.showFleet(session.fleet === true);
if (!session.fleet) setTimeout(lookForFleet, FLEET_LATER_MS);
let wasStale = false;
stream.on("state", async ({ stale }) => {
  const back = wasStale && !stale;
  wasStale = stale;
  if (back && !(await lookForFleet())) setTimeout(lookForFleet, FLEET_LATER_MS);
});

/** Logs out: first the hobs go off that the pages of this session heat. */
async function leave() {
  await Promise.all([leases.releaseAll("you logged out", { timeoutMs: LEAVE_MS }), tabs.leave()]);
  await logout().catch(() => {});
  location.reload();
}

let logsIn = false;

/** The session has ended: asks for a token in place of the view, here or on another page. The header and what Off tells stay. */
async function logIn() {
  if (logsIn) return;
  logsIn = true;
  unmount();
  const heard = new Promise((/** @type {(value: void) => void} */ resolve) => {
    const end = stream.on("state", ({ stale, failures }) => !stale && failures === 0 && resolve(end()));
  });
  await Promise.race([login(main), heard]);
  Object.assign(session, await readSession().catch(() => null));
  logsIn = false;
  place = { ...place, view: "" };
  stream.rest();
  stream.wake();
  go(placeOf(location.hash));
}

/** Takes the view away; one that is still being loaded does not come. */
function unmount() {
  visit += 1;
  mounted?.unmount();
  mounted = null;
}

/**
 * Shows a view. The device that the hash names stays chosen where the daemon does not know it: Set and Off never go to another one.
 * @param {{view: string, device: string}} wanted
 */
async function go(wanted) {
  if (logsIn) return;
  const device = wanted.device || place.device || (fleet.names()[0] ?? "");
  const { label, device: ofDevice } = /** @type {(typeof VIEWS)[number]} */ (VIEWS.find((view) => view.name === wanted.view));
  const isKnown = !ofDevice || fleet.reports.has(device);
  if (wanted.view === place.view && device === place.device && isKnown === place.isKnown) return;
  place = { view: wanted.view, device, isKnown };
  unmount();
  const own = visit;
  header.showPlace(place.view, device);
  const root = h("div", { class: `view view-${place.view}` });
  if (!isKnown) {
    noDevice(root, label, device);
    main.replaceChildren(root);
    return;
  }
  try {
    const [module] = await Promise.all([import(`./views/${place.view}.js`), style(place.view)]);
    if (own !== visit) return;
    main.replaceChildren(root);
    mounted = module.mount(root, context());
  } catch (why) {
    if (own !== visit) return;
    main.replaceChildren(h("p", { class: "bad", role: "alert" }, `The view ${place.view} cannot be shown: ${why instanceof Error ? why.message : why}. Reload the page.`));
  }
}

/** @returns {import("./context.js").Context} */
function context() {
  return {
    api, stream, fleet, hob, session, theme, leases, off, announce, complain, ask,
    device: place.device,
    foundFleet: () => header.showFleet(true),
    navigate: (hash) => {
      location.hash = hash;
    },
  };
}

/**
 * A view's own style sheet, loaded once.
 * @param {string} view
 * @returns {Promise<void>}
 */
function style(view) {
  const href = new URL(`../css/${view}.css`, import.meta.url).href;
  if ([...document.styleSheets].some((sheet) => sheet.href === href)) return Promise.resolve();
  return new Promise((resolve) => {
    const link = h("link", { rel: "stylesheet", href, on: { load: () => resolve(), error: () => resolve() } });
    document.head.append(link);
  });
}

addEventListener("hashchange", () => {
  go(placeOf(location.hash)).then(() => main.focus({ preventScroll: true }));
});
stream.on("devices", () => {
  // The device that is shown came or went, or the first one has come.
  go(place);
});
stream.on("state", async ({ failures }) => {
  // An EventSource does not say why it was refused; the session does.
  if (failures % 4 === 2 && (await readSession().catch(() => undefined)) === null) logIn();
});
// Power that was on its way when Off was pressed may have come after it.
leases.overtaken = (/** @type {string} */ device) => off.only(device);
leases.on(() => {
  for (const [name, state] of leases.states) {
    if (state.phase !== "lost") continue;
    leases.seen(name);
    complain(`${name} is not heated by this page any more: ${state.why}.`);
  }
});

stream.on("notice", (notice) => {
  const heatedHere = leases.heated().includes(notice.device);
  if (notice.event === "fault" && notice.fault !== 0 && heatedHere) complain(`${notice.device}, which this page heats: fault ${notice.fault}, ${notice.text}`);
});

// Without a stream for all, a hidden page that heats nothing gives its connection to others where there are many.
const tabs = new Tabs(settle, () => leases.releaseAll("you logged out on another page", { timeoutMs: LEAVE_MS }));
function settle() {
  if (!isShared() && document.hidden && leases.heated().length === 0 && tabs.count() > MAX_STREAMS) stream.rest();
  else stream.wake();
}
document.addEventListener("visibilitychange", settle);
leases.on(settle);

new StoreBanner(/** @type {HTMLElement} */ (document.querySelector("#store-failure")), stream, api.health);
stream.start();
go(placeOf(location.hash));
