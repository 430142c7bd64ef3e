// @ts-check
/**
 * Files of lookups: the bytes that a device takes (`lookup-vN.bin` of `ihd trainer`), and the JSON of
 * `ihd device DEV lookup show --json`. Layout of the bytes: shared/src/lookup/blob.rs.
 */

const ROWS = 8;
const COLUMNS = 17;
const CELLS = ROWS * COLUMNS;
const OHM_PER_CODE = 16 / 65536;
const HENRY_PER_CODE = 64e-6 / 65536;
const R_AT = 9;
const L_AT = R_AT + 2 * CELLS;
const OBSERVED_AT = L_AT + 2 * CELLS;
const CRC_AT = OBSERVED_AT + Math.ceil(CELLS / 8);

/** Length of a lookup in bytes. */
export const LENGTH = CRC_AT + 4;

/** Largest file that is looked at, in bytes. */
export const MAX_FILE_BYTES = 1_000_000;

/**
 * @typedef {object} Lookup
 * @property {number} version
 * @property {number[][]} r_ohm
 * @property {number[][]} l_h
 * @property {boolean[][]} observed
 */

/** CRC-32 as zlib has it. @param {Uint8Array} bytes */
export function crc32(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) {
    crc ^= byte;
    for (let k = 0; k < 8; k++) crc = crc & 1 ? (crc >>> 1) ^ 0xedb88320 : crc >>> 1;
  }
  return (crc ^ 0xffffffff) >>> 0;
}

/** The bytes that a device takes. @param {Lookup} lookup @returns {Uint8Array} */
export function toBytes(lookup) {
  const bytes = new Uint8Array(LENGTH);
  const view = new DataView(bytes.buffer);
  bytes.set([0x49, 0x48, 0x44, 0x4c, 1]); // "IHDL", format 1
  view.setUint32(5, lookup.version, true);
  const code = (/** @type {number} */ value, /** @type {number} */ unit, /** @type {string} */ what) => {
    const rounded = Math.round(value / unit);
    if (!(rounded >= 0 && rounded <= 65535)) throw new Error(`${what} is ${value}: a lookup holds 0 to ${65535 * unit}`);
    return rounded;
  };
  for (let k = 0; k < CELLS; k++) {
    const [f, i] = [Math.floor(k / COLUMNS), k % COLUMNS];
    view.setUint16(R_AT + 2 * k, code(lookup.r_ohm[f][i], OHM_PER_CODE, `r_ohm[${f}][${i}]`), true);
    view.setUint16(L_AT + 2 * k, code(lookup.l_h[f][i], HENRY_PER_CODE, `l_h[${f}][${i}]`), true);
    if (lookup.observed[f][i]) bytes[OBSERVED_AT + (k >> 3)] |= 1 << (k & 7);
  }
  view.setUint32(CRC_AT, crc32(bytes.subarray(0, CRC_AT)), true);
  return bytes;
}

/** @param {Uint8Array} bytes @returns {Lookup} */
export function fromBytes(bytes) {
  if (bytes.length !== LENGTH) throw new Error(`A lookup has ${LENGTH} bytes, this has ${bytes.length}.`);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (view.getUint32(0) !== 0x4948444c || bytes[4] !== 1) throw new Error("This is not a lookup of format 1.");
  if (view.getUint32(CRC_AT, true) !== crc32(bytes.subarray(0, CRC_AT))) {
    throw new Error("The lookup's CRC-32 does not match: the file is damaged.");
  }
  const table = (/** @type {(k: number) => any} */ of) =>
    Array.from({ length: ROWS }, (_, f) => Array.from({ length: COLUMNS }, (_, i) => of(f * COLUMNS + i)));
  return {
    version: view.getUint32(5, true),
    r_ohm: table((k) => view.getUint16(R_AT + 2 * k, true) * OHM_PER_CODE),
    l_h: table((k) => view.getUint16(L_AT + 2 * k, true) * HENRY_PER_CODE),
    observed: table((k) => (bytes[OBSERVED_AT + (k >> 3)] & (1 << (k & 7))) !== 0),
  };
}

/**
 * The lookup of a file, either kind.
 * @param {Uint8Array} bytes of the file
 * @param {{f_sw_hz: number[], i_a: number[]}} axes of the device's own map
 * @returns {Lookup}
 */
export function read(bytes, axes) {
  if (bytes.length === LENGTH && bytes[0] === 0x49) return fromBytes(bytes);
  const first = bytes.find((byte) => byte > 32);
  if (first !== 0x7b) {
    throw new Error(
      `This is neither a lookup of ${LENGTH} bytes (lookup-vN.bin of ihd trainer) nor the JSON of ihd device DEV lookup show --json.`,
    );
  }
  return fromJson(new TextDecoder().decode(bytes), axes);
}

/** @param {string} text @param {{f_sw_hz: number[], i_a: number[]}} axes @returns {Lookup} */
export function fromJson(text, axes) {
  let parsed;
  try {
    parsed = JSON.parse(text);
  } catch (error) {
    throw new Error(`The file is no JSON: ${/** @type {Error} */ (error).message}.`);
  }
  if (parsed?.active === null) throw new Error("The file says that the built-in lookup is in use: there is nothing to push.");
  const lookup = parsed?.active ?? parsed;
  axis(lookup?.frequency_hz, axes.f_sw_hz, "frequency_hz");
  axis(lookup?.current_a, axes.i_a, "current_a");
  if (!Number.isInteger(lookup.version) || lookup.version < 0 || lookup.version > 0xffffffff) {
    throw new Error(`version is ${JSON.stringify(lookup.version)}, but must be a whole number of 32 bits.`);
  }
  const number = (/** @type {unknown} */ value) => typeof value === "number" && Number.isFinite(value);
  return {
    version: lookup.version,
    r_ohm: table(lookup.r_ohm, "r_ohm", number),
    l_h: table(lookup.l_h, "l_h", number),
    observed: table(lookup.observed, "observed", (value) => typeof value === "boolean"),
  };
}

/** @param {unknown} given @param {number[]} wanted @param {string} name */
function axis(given, wanted, name) {
  const same =
    Array.isArray(given) &&
    given.length === wanted.length &&
    given.every((value, k) => Math.abs(value - wanted[k]) <= 1e-3 * Math.max(Math.abs(wanted[k]), 1));
  if (!same) throw new Error(`${name} of the file is not the device's axis of ${wanted.length} values.`);
}

/** @param {unknown} given @param {string} name @param {(value: unknown) => boolean} fits */
function table(given, name, fits) {
  const right =
    Array.isArray(given) &&
    given.length === ROWS &&
    given.every((row) => Array.isArray(row) && row.length === COLUMNS && row.every(fits));
  if (!right) throw new Error(`${name} of the file is not a table of ${ROWS} by ${COLUMNS}.`);
  return /** @type {any} */ (given);
}

/**
 * The JSON of a map, as `ihd device DEV lookup show --json` writes it and [`read`] takes it.
 * @param {import("./values.js").LookupMap} map
 */
export function toJson(map) {
  const active = {
    version: map.version,
    observed_cells: map.observed.flat().filter(Boolean).length,
    frequency_hz: map.f_sw_hz,
    current_a: map.i_a,
    r_ohm: map.r_ohm,
    l_h: map.l_h,
    observed: map.observed,
  };
  return `${JSON.stringify({ active }, null, 1)}\n`;
}
