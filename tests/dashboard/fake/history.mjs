// Telemetry over a stretch of time, in columns.

import { C_F } from './pot.mjs';
import { verdict } from './windows.mjs';

/** Half-cycles that are looked at in a column, at most. */
const LOOKED_AT = 24;

class Least {
  min = [];
  mean = [];
  max = [];
  push(values) {
    const known = values.filter((x) => x !== null);
    const none = known.length === 0;
    this.min.push(none ? null : Math.min(...known));
    this.mean.push(none ? null : known.reduce((a, b) => a + b, 0) / known.length);
    this.max.push(none ? null : Math.max(...known));
  }
}

/** Of the mean R, L and frequency: the bridge's phase in degree, and the resonance in hertz. */
export function tank(r, l, f) {
  if (r === null || l === null || f === null) return [null, null];
  const omega = 2 * Math.PI * f;
  const phase = (Math.atan2(omega * l - 1 / (omega * C_F), r) * 180) / Math.PI;
  return [phase, 1 / (2 * Math.PI * Math.sqrt(l * C_F))];
}

/** `silent`: stretches [from, to] in milliseconds in which the daemon heard nothing. */
export function history(hob, fromMs, toMs, columns, silent) {
  const stepMs = Math.max(1, Math.ceil((toMs - fromMs) / columns));
  const names = ['power_w', 'r_ohm', 'l_h', 'f_sw_hz', 'i_crest_a'];
  const envelopes = Object.fromEntries(names.map((name) => [name, new Least()]));
  const lists = { at_ms: [], half_cycles: [], phase_deg: [], resonance_hz: [], asked_w: [], state: [], pot: [], fault: [] };
  const end = Math.min(toMs, Date.now());
  for (let at = Math.max(fromMs, 0); at < end; at += stepMs) {
    if (at + stepMs <= hob.bootMs || silent.some(([a, b]) => at >= a && at + stepMs <= b)) continue;
    const first = Math.max(0, hob.number(at) + 1);
    const last = hob.number(Math.min(at + stepMs, end));
    if (last < first) continue;
    const count = last - first + 1;
    const looked = Math.min(count, LOOKED_AT);
    const seen = Array.from({ length: looked }, (_, k) => hob.halfCycle(first + Math.floor((k * count) / looked)));
    const final = seen[looked - 1];
    envelopes.power_w.push(seen.map((h) => h.powerW));
    envelopes.r_ohm.push(seen.map((h) => h.rOhm));
    envelopes.l_h.push(seen.map((h) => h.lH));
    envelopes.f_sw_hz.push(seen.map((h) => h.fSwHz || null));
    envelopes.i_crest_a.push(seen.map((h) => h.iCrestA));
    const mean = (name) => envelopes[name].mean[envelopes[name].mean.length - 1];
    const [phase, resonance] = tank(mean('r_ohm'), mean('l_h'), mean('f_sw_hz'));
    lists.at_ms.push(Math.round(at));
    lists.half_cycles.push(count);
    lists.phase_deg.push(phase);
    lists.resonance_hz.push(resonance);
    lists.asked_w.push(final.askedW);
    lists.state.push(final.state);
    lists.pot.push(final.pot);
    lists.fault.push(Math.max(...seen.map((h) => h.fault)));
  }
  return { from_ms: fromMs, to_ms: toMs, step_ms: stepMs, ...lists, ...envelopes, results: results(hob, fromMs, end, columns) };
}

function results(hob, fromMs, toMs, columns) {
  const [first, last] = [Math.max(0, hob.newestSeq(fromMs) + 1), hob.newestSeq(toMs)];
  const of = Math.max(0, last - first + 1);
  const step = Math.max(1, Math.ceil(of / columns));
  const out = { of: 0, at_ms: [], r_ohm: [], l_h: [], sigma_r_pct: [], sigma_l_pct: [], pass: [] };
  for (let seq = first; seq <= last; seq += step) {
    const window = hob.windowOf(seq);
    if (!window) continue;
    const told = verdict(hob, window);
    out.of += step;
    out.at_ms.push(Math.round(window.atMs));
    for (const name of ['r_ohm', 'l_h', 'sigma_r_pct', 'sigma_l_pct', 'pass']) out[name].push(told[name]);
  }
  return out;
}
