// @ts-check
/** Telemetry of one interval of the live stream, and how two become one. */

/**
 * What came of one device in an interval.
 * @typedef {{half_cycles: number, skipped: number, last: Live, phase_deg: number | null, resonance_hz: number | null,
 *   power_w: Range | null, r_ohm: Range | null, l_h: Range | null, f_sw_hz: Range | null}} DeviceTelemetry
 * @typedef {[number, number]} Range least and largest
 * @typedef {{half_cycle: number, state: string, pot: string, fault: number, fault_text: string, limit: string,
 *   asked_w: number, power_w: number, f_sw_hz: number, i_crest_a: number, r_ohm: number, l_h: number, glass_hot: boolean}} Live
 * @typedef {{at_ms: number, devices: Record<string, DeviceTelemetry>}} Telemetry
 */

/** Quantities of which an interval has the least and the largest. */
const RANGES = /** @type {const} */ (["power_w", "r_ohm", "l_h", "f_sw_hz"]);

/**
 * Two intervals as one: extremes of both, the later one's last half-cycle, counts added.
 * @param {Telemetry} earlier
 * @param {Telemetry} later
 * @returns {Telemetry}
 */
export function mergeTelemetry(earlier, later) {
  const devices = { ...earlier.devices };
  for (const [name, b] of Object.entries(later.devices)) {
    const a = earlier.devices[name];
    devices[name] = a ? mergeDevice(a, b) : b;
  }
  return { at_ms: later.at_ms, devices };
}

/**
 * @param {DeviceTelemetry} a
 * @param {DeviceTelemetry} b
 * @returns {DeviceTelemetry}
 */
function mergeDevice(a, b) {
  const merged = { ...b, half_cycles: a.half_cycles + b.half_cycles, skipped: a.skipped + b.skipped };
  for (const quantity of RANGES) merged[quantity] = union(a[quantity], b[quantity]);
  return merged;
}

/**
 * @param {Range | null} a
 * @param {Range | null} b
 * @returns {Range | null}
 */
export function union(a, b) {
  if (!a) return b;
  if (!b) return a;
  return [Math.min(a[0], b[0]), Math.max(a[1], b[1])];
}

/**
 * Whether the inverter is on: R, L and f_sw are known then.
 * @param {Live | null | undefined} live
 * @returns {boolean}
 */
export function heats(live) {
  return !!live && live.f_sw_hz > 0;
}
