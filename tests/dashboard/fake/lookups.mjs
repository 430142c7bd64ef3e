// Lookups of a hob: versions, each with more cells observed than the one before, and their bytes (shared/src/lookup/blob.rs).

import { crc32 } from 'node:zlib';

import { COLUMNS_A, POTS, ROWS_HZ, prior } from './pot.mjs';
import { normal, uniform } from './random.mjs';

const CELLS = ROWS_HZ.length * COLUMNS_A.length;
const OHM_PER_CODE = 16 / 65536;
const HENRY_PER_CODE = 64e-6 / 65536;
const BYTES = 9 + 4 * CELLS + Math.ceil(CELLS / 8) + 4;

/** What cells hold: those observed the pot's, the others the prior's. */
export class Lookups {
  constructor(hob) {
    this.hob = hob;
    this.versions = [];
  }

  get active() {
    return this.versions.find((v) => v.state === 'active') ?? null;
  }

  /** Builds the next version from what is known so far, and makes it the active one. */
  learn(atMs, why = 'learned from windows') {
    const before = this.active;
    const stage = this.versions.length + 1;
    const observed = this.grid((row, column) => {
      // Heating runs over frequencies and currents from the middle outwards.
      const far = Math.hypot((row - 2.6) / 3, (column - 10) / 6);
      return (before?.observed[row][column] ?? false) || far < 0.22 + 0.1 * stage;
    });
    const pot = POTS[this.hob.pot0];
    const noise = (row, column) => 1 + 0.004 * normal(this.hob.seed * 41 + stage, row * 17 + column);
    const cells = (name) =>
      this.grid((row, column) => {
        const [f, i] = [ROWS_HZ[row], COLUMNS_A[column]];
        return observed[row][column] ? pot.at(f, i, 1.05)[name] * noise(row, column) : prior(f, i)[name];
      });
    return this.activate({ r: cells('r'), l: cells('l'), observed, origin: 'host', why }, atMs);
  }

  grid(cell) {
    return ROWS_HZ.map((_, row) => COLUMNS_A.map((_, column) => cell(row, column)));
  }

  activate({ r, l, observed, origin, why }, atMs) {
    for (const old of this.versions) if (old.state === 'active') Object.assign(old, { state: 'superseded', at_ms: atMs });
    const version = Math.max(0, ...this.versions.map((v) => v.version)) + 1;
    const made = { version, state: 'active', at_ms: atMs, origin, why, r, l, observed };
    this.versions.push(made);
    return made;
  }

  refuse(why, atMs) {
    const version = Math.max(0, ...this.versions.map((v) => v.version)) + 1;
    const { r, l, observed } = this.active ?? this.learn(atMs);
    this.versions.push({ version, state: 'refused', at_ms: atMs, origin: 'host', why, r, l, observed });
  }

  /** The version of that number, or the one before the active one; null where there is none. */
  wanted(version) {
    if (version !== undefined) return this.versions.find((v) => v.version === version && v.state !== 'refused') ?? null;
    return this.versions.filter((v) => v.state === 'superseded').pop() ?? null;
  }

  reset() {
    for (const old of this.versions) if (old.state === 'active') old.state = 'superseded';
  }

  /** From the bytes of a lookup; an error in words where they are none. */
  push(bytes, atMs) {
    const blob = Buffer.from(bytes);
    if (blob.length !== BYTES) throw new Error(`a lookup has ${BYTES} bytes, not ${blob.length}`);
    if (blob.toString('latin1', 0, 4) !== 'IHDL' || blob[4] !== 1) throw new Error('not a lookup of format 1');
    if (blob.readUInt32LE(BYTES - 4) !== crc32(blob.subarray(0, BYTES - 4))) throw new Error("the lookup's CRC-32 does not match");
    const at = (base, scale) => this.grid((row, column) => blob.readUInt16LE(base + 2 * (row * 17 + column)) * scale);
    const bits = 9 + 4 * CELLS;
    const observed = this.grid((row, column) => ((blob[bits + ((row * 17 + column) >> 3)] >> ((row * 17 + column) & 7)) & 1) === 1);
    const [r, l] = [at(9, OHM_PER_CODE), at(9 + 2 * CELLS, HENRY_PER_CODE)];
    return this.activate({ r, l, observed, origin: 'host', why: 'pushed by hand' }, atMs);
  }

  stored() {
    const newest = [...this.versions].reverse();
    return newest.map((v) => ({
      version: v.version,
      state: v.state,
      at_ms: Math.round(v.at_ms),
      origin: v.origin,
      why: v.why,
      blob: [...bytesOf(v)],
    }));
  }

  /** As `/map` answers it. */
  map(version, nowMs) {
    const of = version === 0 ? null : (version === undefined ? this.active : this.versions.find((v) => v.version === version));
    if (version && !of) return null;
    const all = (name) => of?.[name] ?? this.grid((row, column) => prior(ROWS_HZ[row], COLUMNS_A[column])[name]);
    const [r, l] = [all('r'), all('l')];
    const observed = of?.observed ?? this.grid(() => false);
    // Cells are observed up to a deviation of 3 % of R and 1.5 % of L.
    const sigma = (name, most) => {
      const doubt = (row, column) => uniform(this.hob.seed * (name === 'r' ? 47 : 53), row * 17 + column);
      return this.grid((row, column) => most * (observed[row][column] ? 0.03 + 0.9 * doubt(row, column) : 1.1 + 9 * doubt(row, column)));
    };
    const old = (row, column) => Math.floor(5 + 3000 * uniform(this.hob.seed * 43, row * 17 + column));
    // As in the daemon: of what an earlier version of it built it is not known how sure it is.
    const confident = of && of.at_ms >= nowMs - 3 * 3600e3;
    return {
      version: of?.version ?? 0,
      state: of?.state ?? 'prior',
      at_ms: of ? Math.round(of.at_ms) : 0,
      origin: of?.origin ?? 'firmware',
      why: of?.why ?? '',
      f_sw_hz: ROWS_HZ,
      i_a: COLUMNS_A,
      r_ohm: r,
      l_h: l,
      power_w: this.grid((row, column) => (r[row][column] * COLUMNS_A[column] ** 2) / 2),
      observed,
      sigma_r_pct: confident ? sigma('r', 3) : null,
      sigma_l_pct: confident ? sigma('l', 1.5) : null,
      confidence: confident ? this.grid((row, column) => (observed[row][column] ? 1 - old(row, column) / 4000 : 0)) : null,
      age_s: this.grid((row, column) => (observed[row][column] ? old(row, column) : null)),
    };
  }
}

function bytesOf({ version, r, l, observed }) {
  const blob = Buffer.alloc(BYTES);
  blob.write('IHDL', 'latin1');
  blob[4] = 1;
  blob.writeUInt32LE(version, 5);
  const cell = (k) => [Math.floor(k / 17), k % 17];
  for (let k = 0; k < CELLS; k++) {
    const [row, column] = cell(k);
    blob.writeUInt16LE(Math.round(r[row][column] / OHM_PER_CODE), 9 + 2 * k);
    blob.writeUInt16LE(Math.round(l[row][column] / HENRY_PER_CODE), 9 + 2 * CELLS + 2 * k);
    if (observed[row][column]) blob[9 + 4 * CELLS + (k >> 3)] |= 1 << (k & 7);
  }
  blob.writeUInt32LE(crc32(blob.subarray(0, BYTES - 4)), BYTES - 4);
  return blob;
}
