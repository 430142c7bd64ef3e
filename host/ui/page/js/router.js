// @ts-check
/** Places of the page by hash: `#/live/bench`. */

/** The views, in the order of the navigation; `edge`: in it only where the daemon is an edge of a fleet. */
export const VIEWS = [
  { name: "devices", label: "Devices", device: false },
  { name: "live", label: "Live", device: true },
  { name: "map", label: "Map", device: true },
  { name: "training", label: "Training", device: true },
  { name: "events", label: "Events", device: false },
  { name: "recordings", label: "Recordings", device: false },
  { name: "fleet", label: "Fleet", device: false, edge: true },
];

/**
 * @param {string} view
 * @param {string} device
 * @returns {string}
 */
export function hashOf(view, device) {
  const one = VIEWS.find((candidate) => candidate.name === view);
  return one?.device && device ? `#/${view}/${encodeURIComponent(device)}` : `#/${view}`;
}

/**
 * @param {string} hash
 * @returns {{view: string, device: string}} devices where it names nothing that there is
 */
export function placeOf(hash) {
  const [, view = "", device = ""] = hash.replace(/^#/, "").split("/");
  const known = VIEWS.some((candidate) => candidate.name === view);
  let name = "";
  try {
    name = decodeURIComponent(device);
  } catch {
    // A hash that was typed wrong names no device.
  }
  return known ? { view, device: name } : { view: "devices", device: "" };
}
