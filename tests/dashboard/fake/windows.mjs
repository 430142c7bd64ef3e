// Windows of samples, what a scope would measure of them, and what was learned from them.

import { BUS_PEAK_V, C_F } from './pot.mjs';
import { normal, uniform } from './random.mjs';

const PAIRS_PER_BLOCK = 61;
const PERIODS_PER_BLOCK = 3;
const HARMONICS = [1, 3, 5, 7];
const VOLT_PER_CODE = 640 / 2048;
const AMPERE_PER_CODE = 80 / 2048;
const HALF_CYCLE_S = 0.01;

/** The samples of a window and the truth block by block. */
export function samples(hob, window) {
  const { fSw, pot, warm, n } = window;
  const rate = (fSw * PAIRS_PER_BLOCK) / PERIODS_PER_BLOCK;
  const blocks = Math.floor((HALF_CYCLE_S * fSw) / PERIODS_PER_BLOCK);
  const pairs = blocks * PAIRS_PER_BLOCK;
  const omega = 2 * Math.PI * fSw;
  const v = new Float32Array(pairs);
  const i = new Float32Array(pairs);
  const truth = { t: [], r: [], l: [], i: [] };
  let saturated = 0;
  for (let block = 0; block < blocks; block++) {
    const middle = ((block + 0.5) * PAIRS_PER_BLOCK) / rate;
    const bus = BUS_PEAK_V * Math.abs(Math.sin((Math.PI * middle) / HALF_CYCLE_S));
    const at = pot.current(fSw, bus, warm);
    truth.t.push(middle);
    truth.r.push(at.r);
    truth.l.push(at.l);
    truth.i.push(at.i);
    const tones = HARMONICS.map((h) => {
      // R grows with the square root of frequency, L falls a little: as in pot.mjs.
      const [r, l] = [at.r * Math.sqrt(h), at.l * h ** -0.3];
      const amplitude = (2 / Math.PI) * (bus / h);
      const x = h * omega * l - 1 / (h * omega * C_F);
      const current = amplitude / Math.hypot(r, x);
      const lag = Math.atan2(x, r);
      return { h, current, lag, v: current * Math.hypot(r, h * omega * l), lead: Math.atan2(h * omega * l, r) - lag };
    });
    for (let k = 0; k < PAIRS_PER_BLOCK; k++) {
      const index = block * PAIRS_PER_BLOCK + k;
      const phase = (2 * Math.PI * PERIODS_PER_BLOCK * k) / PAIRS_PER_BLOCK;
      let [sumV, sumI] = [0, 0];
      for (const tone of tones) {
        sumV += tone.v * Math.sin(tone.h * phase + tone.lead);
        sumI += tone.current * Math.sin(tone.h * phase - tone.lag);
      }
      const noise = normal(hob.seed + n, index);
      v[index] = code(sumV / VOLT_PER_CODE + 0.5 * noise) * VOLT_PER_CODE;
      i[index] = code(sumI / AMPERE_PER_CODE + 0.4 * normal(hob.seed - n, index)) * AMPERE_PER_CODE;
      if (Math.abs(v[index]) >= 639 || Math.abs(i[index]) >= 79.9) saturated += 1;
    }
  }
  return { rate, pairs, blocks, v, i, truth, saturated };
}

function code(x) {
  return Math.max(-2048, Math.min(2047, Math.round(x)));
}

/** A window as `/window` answers it. */
export function scope(hob, window, cached, fromS, toS, columns) {
  const { rate, pairs, v, i, saturated } = cached;
  const duration = pairs / rate;
  const from = Math.min(Math.max(0, fromS), duration);
  const to = Math.min(Math.max(from, toS), duration);
  const first = Math.ceil(from * rate - 1e-9);
  const last = Math.min(pairs, Math.max(first + 1, Math.floor(to * rate + 1e-9)));
  const width = Math.max(1, (last - first) / columns);
  const out = { t_s: [], v_min_v: [], v_max_v: [], i_min_a: [], i_max_a: [] };
  for (let column = 0; first + column * width < last - 1e-9; column++) {
    const begin = Math.floor(first + column * width);
    const end = Math.min(last, Math.max(begin + 1, Math.floor(first + (column + 1) * width)));
    const part = (a) => [Math.min(...a.subarray(begin, end)), Math.max(...a.subarray(begin, end))];
    const [[vMin, vMax], [iMin, iMax]] = [part(v), part(i)];
    out.t_s.push((begin + end - 1) / 2 / rate);
    out.v_min_v.push(vMin);
    out.v_max_v.push(vMax);
    out.i_min_a.push(iMin);
    out.i_max_a.push(iMax);
  }
  const fit = verdict(hob, window);
  const curves = trajectories(hob, window, cached);
  const view = (c) => c && clip(c, from, to);
  return {
    boot: hob.boot,
    seq: window.seq,
    at_ms: Math.round(window.atMs + 40),
    half_cycle: window.n,
    f_sw_hz: window.fSw,
    sample_rate_hz: rate,
    duration_s: duration,
    pairs,
    saturated,
    from_s: from,
    to_s: to,
    decimated: width > 1,
    ...out,
    measured: measured(cached, first, last),
    ekf: view(curves.ekf),
    network: view(curves.network),
    pass: fit.pass,
    why: fit.why,
    truth: view(curves.truth),
    r_mean_ohm: fit.r_ohm,
    l_mean_h: fit.l_h,
    r_true_mean_ohm: fit.rTrue,
    l_true_mean_h: fit.lTrue,
  };
}

function clip(curve, from, to) {
  const keep = curve.t_s.map((t) => t >= from && t <= to);
  const cut = (list) => list.filter((_, k) => keep[k]);
  return Object.fromEntries(Object.entries(curve).map(([name, list]) => [name, list.length ? cut(list) : list]));
}

/** R(t) and L(t) from the filter, the network and the truth. */
function trajectories(hob, window, { truth }) {
  const curve = () => ({ t_s: [], r_ohm: [], l_h: [], r_sigma_ohm: [], l_sigma_h: [] });
  const [ekf, network, real] = [curve(), curve(), curve()];
  const wave = 2 * Math.PI * uniform(hob.seed, window.seq);
  truth.t.forEach((t, k) => {
    const noise = (j) => normal(hob.seed * 13 + j, window.n * 400 + k);
    // Where little current flows nobody knows R and L well.
    const doubt = 4 / (truth.i[k] + 1.5);
    const late = truth.r[Math.max(0, k - 3)];
    push(real, t, truth.r[k], truth.l[k]);
    push(ekf, t, late * (1 + 0.006 * doubt * noise(1)), truth.l[Math.max(0, k - 3)] * (1 + 0.002 * doubt * noise(2)));
    const slow = Math.sin(wave + 9 * t * 100);
    push(network, t, truth.r[k] * (1 + 0.0012 * doubt * slow), truth.l[k] * (1 + 0.0005 * doubt * slow));
    network.r_sigma_ohm.push(truth.r[k] * 0.002 * doubt);
    network.l_sigma_h.push(truth.l[k] * 0.0008 * doubt);
  });
  return { ekf, network, truth: real };
}

function push(curve, t, r, l) {
  curve.t_s.push(t);
  curve.r_ohm.push(r);
  curve.l_h.push(l);
}

/** Over the whole switching periods between two pairs. */
function measured({ v, i }, first, last) {
  const blocks = Math.floor((last - first) / PAIRS_PER_BLOCK);
  const empty = ['v_rms_v', 'i_rms_a', 'v_peak_v', 'i_peak_a', 'power_w', 'power_factor', 'phase_deg', 'thd_v_pct', 'thd_i_pct'];
  if (blocks < 1) return { periods: 0, ...Object.fromEntries(empty.map((name) => [name, null])) };
  const n = blocks * PAIRS_PER_BLOCK;
  let [vv, ii, vi, vPeak, iPeak] = [0, 0, 0, 0, 0];
  for (let k = first; k < first + n; k++) {
    vv += v[k] * v[k];
    ii += i[k] * i[k];
    vi += v[k] * i[k];
    vPeak = Math.max(vPeak, Math.abs(v[k]));
    iPeak = Math.max(iPeak, Math.abs(i[k]));
  }
  const spectrum = (a) => Array.from({ length: 10 }, (_, h) => tone(a, first, n, h + 1));
  const [sv, si] = [spectrum(v), spectrum(i)];
  const [vRms, iRms] = [Math.sqrt(vv / n), Math.sqrt(ii / n)];
  const thd = (s) => (100 * Math.hypot(...s.slice(1).map((c) => c.size))) / s[0].size;
  return {
    periods: blocks * PERIODS_PER_BLOCK,
    v_rms_v: vRms,
    i_rms_a: iRms,
    v_peak_v: vPeak,
    i_peak_a: iPeak,
    power_w: vi / n,
    power_factor: vi / n / (vRms * iRms),
    phase_deg: ((((sv[0].angle - si[0].angle) * 180) / Math.PI + 540) % 360) - 180,
    thd_v_pct: thd(sv),
    thd_i_pct: thd(si),
  };
}

function tone(a, first, n, harmonic) {
  const step = (2 * Math.PI * PERIODS_PER_BLOCK * harmonic) / PAIRS_PER_BLOCK;
  let [re, im] = [0, 0];
  for (let k = 0; k < n; k++) {
    re += a[first + k] * Math.cos(step * k);
    im -= a[first + k] * Math.sin(step * k);
  }
  return { size: Math.hypot(re, im), angle: Math.atan2(im, re) };
}

/** Means over the half-cycle weighted with the squared current, and what the gate said. */
export function verdict(hob, window) {
  let [w, r, l] = [0, 0, 0];
  for (let k = 0; k < 12; k++) {
    const at = window.pot.current(window.fSw, BUS_PEAK_V * Math.sin((Math.PI * (k + 0.5)) / 12), window.warm);
    w += at.i * at.i;
    r += at.r * at.i * at.i;
    l += at.l * at.i * at.i;
  }
  const [rTrue, lTrue] = [r / w, l / w];
  const noise = (j) => normal(hob.seed * 17 + j, window.n);
  const pass = uniform(hob.seed * 19, window.seq) >= 0.06;
  const refusal = window.seq % 2 ? 'noise: the residual is 2.4 times the noise of the samples' : 'range: sigma of R is 3.1 %, more than 2 %';
  return {
    rTrue,
    lTrue,
    r_ohm: rTrue * (1 + 0.001 * noise(1)),
    l_h: lTrue * (1 + 0.0004 * noise(2)),
    sigma_r_pct: pass ? 0.14 + 0.04 * Math.abs(noise(3)) : 3.1,
    sigma_l_pct: pass ? 0.05 + 0.02 * Math.abs(noise(4)) : 1.2,
    pass,
    why: pass ? '' : refusal,
  };
}

/** A fit as `/training` answers it; its steps are known since the daemon's start only. */
export function fit(hob, window, sinceMs) {
  const told = verdict(hob, window);
  const known = window.atMs >= sinceMs;
  const iterations = 10 + Math.floor(30 * uniform(hob.seed * 23, window.seq));
  const remarks = told.pass
    ? [{ code: 'quantised', severity: 'info', text: 'the current spans 1400 of 4096 codes' }]
    : [{ code: told.why.split(':')[0], severity: 'error', text: told.why }];
  const steps = Array.from({ length: iterations }, (_, k) => ({
    step: k + 1,
    loss: 2e-3 * Math.exp(-k / 4) + 3e-6 * (1 + 0.2 * uniform(window.seq, k)),
    change: 0.3 * Math.exp(-k / 3) + 1e-5,
  }));
  return {
    boot: hob.boot,
    seq: window.seq,
    at_ms: Math.round(window.atMs + 90),
    f_sw_hz: window.fSw,
    r_ohm: told.r_ohm,
    l_h: told.l_h,
    sigma_r_pct: told.sigma_r_pct,
    sigma_l_pct: told.sigma_l_pct,
    pass: told.pass,
    why: told.why,
    remarks: known ? remarks : [],
    changed_lookup: told.pass && window.seq % 8 === 0,
    iterations,
    seconds: known ? 0.02 + 0.0008 * iterations : null,
    steps: known ? steps : [],
    r_error_pct: 100 * (told.r_ohm / told.rTrue - 1),
    l_error_pct: 100 * (told.l_h / told.lTrue - 1),
  };
}
