import assert from "node:assert/strict";
import { test } from "node:test";
import { crc32, fromBytes, LENGTH, read, toBytes, toJson } from "../page/js/map/lookup-file.js";

const f_sw_hz = Array.from({ length: 8 }, (_, k) => 30e3 * (80 / 30) ** (k / 7));
const i_a = Array.from({ length: 17 }, (_, k) => 5 * (17 ** (k / 16) - 1));
const axes = { f_sw_hz, i_a };
const grid = (of) => f_sw_hz.map((_, f) => i_a.map((_, i) => of(f, i)));
const lookup = {
  version: 70_007,
  r_ohm: grid((f, i) => (20_000 + 500 * f - 300 * i) * (16 / 65536)),
  l_h: grid((f, i) => (30_000 - 700 * f - 200 * i) * (64e-6 / 65536)),
  observed: grid((f, i) => (f * 17 + i) % 5 === 0),
};
const text = (string) => new TextEncoder().encode(string);

test("the CRC is zlib's", () => {
  // The check value of CRC-32/ISO-HDLC in the catalogue of parametrised CRCs.
  assert.equal(crc32(text("123456789")), 0xcbf43926);
});

test("bytes lie where shared/src/lookup/blob.rs has them", () => {
  const bytes = toBytes(lookup);
  assert.equal(bytes.length, 4 + 1 + 4 + 272 + 272 + 17 + 4);
  assert.equal(LENGTH, bytes.length);
  assert.deepEqual([...bytes.subarray(0, 9)], [0x49, 0x48, 0x44, 0x4c, 1, 0x77, 0x11, 0x01, 0x00]);
  const view = new DataView(bytes.buffer);
  assert.equal(view.getUint16(9 + 2 * (3 * 17 + 4), true), 20_000 + 1500 - 1200);
  assert.equal(view.getUint16(281 + 2 * (7 * 17 + 16), true), 30_000 - 4900 - 3200);
  assert.equal(bytes[553], 0b00100001, "cells 0 and 5 of the first eight");
  assert.equal(view.getUint32(570, true), crc32(bytes.subarray(0, 570)));
});

test("bytes and back, JSON and back, are the same lookup bit for bit", () => {
  const bytes = toBytes(lookup);
  assert.deepEqual(toBytes(fromBytes(bytes)), bytes);
  assert.deepEqual(read(bytes, axes).observed, lookup.observed);
  const json = toJson({ ...lookup, ...axes });
  assert.deepEqual(toBytes(read(text(json), axes)), bytes);
});

test("what the command line prints is read", () => {
  // As `cells` in host/ihd/src/cli/device/lookup.rs: codes times the unit.
  const active = { version: 9, observed_cells: 1, frequency_hz: f_sw_hz, current_a: i_a, r_ohm: lookup.r_ohm, l_h: lookup.l_h, observed: lookup.observed };
  assert.equal(read(text(JSON.stringify({ active, stored: [] })), axes).version, 9);
  assert.throws(() => read(text(JSON.stringify({ active: null, stored: [] })), axes), /built-in/);
});

test("damaged, foreign and hostile files are refused in words", () => {
  const flipped = toBytes(lookup);
  flipped[100] ^= 4;
  assert.throws(() => read(flipped, axes), /CRC/);
  assert.throws(() => read(toBytes(lookup).subarray(0, 500), axes), /neither/);
  assert.throws(() => read(new Uint8Array(), axes), /neither/);
  assert.throws(() => read(text("{"), axes), /no JSON/);
  assert.throws(() => read(text("{}"), axes), /frequency_hz/);
  const good = JSON.parse(toJson({ ...lookup, ...axes })).active;
  for (const [change, why] of [
    [{ frequency_hz: f_sw_hz.map((f) => f * 2) }, /frequency_hz/],
    [{ current_a: i_a.slice(1) }, /current_a/],
    [{ version: -1 }, /version/],
    [{ version: 1.5 }, /version/],
    [{ r_ohm: lookup.r_ohm.slice(1) }, /r_ohm/],
    [{ l_h: grid(() => "28e-6") }, /l_h/],
    [{ observed: grid(() => 1) }, /observed/],
    [{ r_ohm: grid(() => null) }, /r_ohm/],
  ]) {
    assert.throws(() => read(text(JSON.stringify({ active: { ...good, ...change } })), axes), why);
  }
  const wild = read(text(JSON.stringify({ active: { ...good, r_ohm: grid(() => 99) } })), axes);
  assert.throws(() => toBytes(wild), /r_ohm\[0\]\[0\] is 99/);
});
