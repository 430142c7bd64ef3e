// @ts-check
/**
 * Power of one device as a lease, as states without clocks or requests: what comes in is an event with its time,
 * what goes out is the next state.
 *
 * | state    | what it means                                                  | leaves it |
 * |----------|----------------------------------------------------------------|-----------|
 * | `none`   | this page does not heat it                                      | `take` |
 * | `taking` | lease and power are on their way                                | `powered`, `refused`, `off` |
 * | `held`   | this page heats it, and renews                                  | `off`, `taken`, `silent`, `ended`, `done` |
 * | `late`   | no renewal has come through for a while; the hob may go off     | `renewed`, `taken`, `silent`, `off` |
 * | `lost`   | it was heated, and is not any more by this page; `why` says it  | `take`, `off`, `seen` |
 */

/** Renewals fail for so long before it is said, in milliseconds. */
export const LATE_MS = 6500;

/**
 * `asked_w` is there while power flows: more than `power_w` where the hob took its rating.
 * @typedef {{phase: "none" | "taking" | "held" | "late" | "lost", power_w: number, asked_w?: number, renewed_ms: number, why: string}}
 *   LeaseState
 * @typedef {{type: "take", power_w: number, at_ms: number}
 *   | {type: "powered", power_w: number, asked_w?: number, at_ms: number}
 *   | {type: "reported", power_w: number}
 *   | {type: "renewed", at_ms: number}
 *   | {type: "tick", at_ms: number, lease_ms: number}
 *   | {type: "refused", why: string}
 *   | {type: "taken", by: string}
 *   | {type: "ended", why: string}
 *   | {type: "done", why: string}
 *   | {type: "off"} | {type: "seen"}} LeaseEvent
 */

/** @returns {number} time in milliseconds, the same in page and worker, that goes on evenly when somebody sets the clock */
export function steady_ms() {
  return performance.timeOrigin + performance.now();
}

/** @returns {LeaseState} */
export function noLease() {
  return { phase: "none", power_w: 0, renewed_ms: 0, why: "" };
}

/**
 * @param {LeaseState} state
 * @param {LeaseEvent} event
 * @returns {LeaseState}
 */
export function step(state, event) {
  const holds = state.phase === "held" || state.phase === "late";
  switch (event.type) {
    case "take":
      return holds
        ? { ...state, why: "" }
        : { phase: "taking", power_w: event.power_w, renewed_ms: event.at_ms, why: "" };
    case "powered":
      return state.phase === "none" || state.phase === "lost"
        ? state
        : { phase: "held", power_w: event.power_w, asked_w: event.asked_w, renewed_ms: event.at_ms, why: "" };
    case "reported":
      // The answer to a command may be lost, and two commands may change places on their way.
      return holds && state.power_w !== event.power_w ? { ...state, power_w: event.power_w, asked_w: event.power_w } : state;
    case "renewed":
      return holds ? { ...state, phase: "held", renewed_ms: Math.max(state.renewed_ms, event.at_ms), why: "" } : state;
    case "tick":
      return holds ? aged(state, event.at_ms - state.renewed_ms, event.lease_ms) : state;
    case "refused":
      return state.phase === "taking" ? { ...noLease(), why: event.why } : state;
    case "taken":
      return holds || state.phase === "taking" ? lost(state, `${event.by} took it over; the hob was switched off first`) : state;
    case "ended":
      return holds ? lost(state, event.why) : state;
    case "done":
      return holds ? { ...noLease(), why: event.why } : state;
    case "off":
      return noLease();
    case "seen":
      return state.phase === "lost" ? noLease() : state;
  }
}

/**
 * @param {LeaseState} state
 * @param {number} silent_ms
 * @param {number} lease_ms
 * @returns {LeaseState}
 */
function aged(state, silent_ms, lease_ms) {
  if (silent_ms > lease_ms) {
    return lost(state, "no renewal came through while the lease lasted; the hob goes off when the lease ends");
  }
  if (silent_ms > LATE_MS) {
    return { ...state, phase: "late", why: "renewals do not come through; the hob goes off when the lease ends" };
  }
  return state;
}

/**
 * @param {LeaseState} state
 * @param {string} why
 * @returns {LeaseState}
 */
function lost(state, why) {
  return { phase: "lost", power_w: state.power_w, renewed_ms: state.renewed_ms, why };
}

/**
 * Whether the worker may go on renewing: the page answered lately. A page that hangs heats nothing.
 * @param {number} answered_ms when the page answered last
 * @param {number} now_ms
 * @param {number} patience_ms
 * @returns {boolean}
 */
export function pageAlive(answered_ms, now_ms, patience_ms) {
  return now_ms - answered_ms <= patience_ms;
}
