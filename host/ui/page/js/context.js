// @ts-check
/**
 * What a view gets; types alone.
 *
 * A view is a module `views/NAME.js` with `export function mount(root, context)`, which fills `root` and returns
 * `{ unmount() }`. Its style sheet `css/NAME.css` is loaded before. `unmount` ends every subscription, timer and
 * request of it.
 *
 * @typedef {object} Context
 * @property {typeof import("./api.js")} api
 * @property {import("./stream.js").Stream} stream
 * @property {import("./fleet.js").Fleet} fleet       newest report of each device, who heats
 * @property {string} device     name of the chosen device; empty where there is none
 * @property {Hob} hob           limits that every device of this build has
 * @property {Session} session
 * @property {import("./theme.js").Theme} theme
 * @property {import("./leases.js").Leases} leases    power of this page
 * @property {import("./off.js").Off} off
 * @property {(hash: string) => void} navigate        `#/live/bench`
 * @property {() => void} foundFleet                  the daemon is an edge: the navigation has the way to it
 * @property {(text: string) => void} announce        said to screen readers
 * @property {(question: Question) => Promise<string | null>} ask   a dialog; the chosen answer's `value`, null for none
 * @property {(text: string, why?: unknown) => void} complain   an error that a person has to see
 *
 * @typedef {{role: "read" | "operate", token_needed: boolean, fleet: boolean}} Session
 * @typedef {{rated_power_w: number, requested_power_max_w: number, f_sw_min_hz: number, f_sw_max_hz: number, resonance_capacitance_f: number,
 *   resonance_margin: number, i_limit_a: number, lease_s: number}} Hob
 * @typedef {{title: string, text: string | (string | Node)[], answers: {label: string, value: string, danger?: boolean}[],
 *   input?: Node}} Question   the first answer does what the title says; `Cancel` is added
 */

export {};
