// The routes of the fake daemon, as docs/daemon.md has the real ones'.

import { Tokens } from './access.mjs';
import { Refusal } from './daemon.mjs';
import { LEASE_MS } from './hob.mjs';
import { history } from './history.mjs';
import { watch } from './live.mjs';
import { C_F, F_MAX_HZ, F_MIN_HZ, I_LIMIT_A, RATED_W, RESONANCE_MARGIN } from './pot.mjs';
import { hash } from './random.mjs';
import { fit, samples, scope } from './windows.mjs';

const HOB = {
  rated_power_w: RATED_W,
  requested_power_max_w: 10_000,
  f_sw_min_hz: F_MIN_HZ,
  f_sw_max_hz: F_MAX_HZ,
  resonance_capacitance_f: C_F,
  // A factor on the frequency: with X = ωL (1 - 1/m²) above resonance, the share that is kept is 1 - 1/m².
  resonance_margin: 1 / Math.sqrt(1 - RESONANCE_MARGIN),
  i_limit_a: I_LIMIT_A,
  lease_s: LEASE_MS / 1000,
};

/** A whole number of the query, within its range. */
function number(query, name, otherwise, low = -Infinity, high = Infinity) {
  if (!query.has(name)) return otherwise;
  const value = Number(query.get(name));
  if (query.get(name) === '' || !Number.isFinite(value)) throw new Refusal(400, 'query', `${name}: not a number`);
  if (value < low || value > high) throw new Refusal(400, 'query', `${name} is ${value}, but must lie between ${low} and ${high}`);
  return value;
}

/** Windows whose samples were made already. */
const kept = new Map();
function samplesOf(hob, window) {
  const key = `${hob.name} ${window.seq}`;
  if (!kept.has(key)) {
    if (kept.size >= 32) kept.delete(kept.keys().next().value);
    kept.set(key, samples(hob, window));
  }
  return kept.get(key);
}

function windowAsked(hob, query) {
  const seq = number(query, 'seq', undefined);
  const boot = number(query, 'boot', undefined);
  const found = seq === undefined ? hob.windows(1)[0] : boot === hob.boot && seq <= hob.newestSeq() && hob.windowOf(seq);
  if (!found) throw new Refusal(404, 'no-window', `${hob.name} has no window ${seq === undefined ? 'with samples' : `${boot}/${seq} with samples`} in the store`);
  return found;
}

const summary = (hob, w) => ({ boot: hob.boot, seq: w.seq, at_ms: Math.round(w.atMs + 40), f_sw_hz: w.fSw, half_cycle: w.n, samples: true });

/** What GET of a device's parts answers. */
const OF_A_DEVICE = {
  history(daemon, hob, query) {
    const to = number(query, 'to', Date.now());
    const from = number(query, 'from', to - 300e3);
    if (from >= to) throw new Refusal(400, 'query', 'from must lie before to');
    return history(hob, from, to, number(query, 'columns', 600, 1, 4000), daemon.silent);
  },
  windows: (_, hob, query) => hob.windows(number(query, 'limit', 100, 1, 10000)).map((w) => summary(hob, w)),
  window(_, hob, query) {
    const window = windowAsked(hob, query);
    const columns = number(query, 'columns', 1200, 1, 4000);
    return scope(hob, window, samplesOf(hob, window), number(query, 'from_s', 0), number(query, 'to_s', 1e9), columns);
  },
  training: (daemon, hob, query) => hob.windows(number(query, 'limit', 50, 1, 10000)).map((w) => fit(hob, w, daemon.startMs - 60e3)),
  'pot-temperature': (daemon) => potCurve(daemon.startMs, Date.now()),
  lookups: (_, hob) => hob.lookups.stored(),
  map(_, hob, query) {
    const version = number(query, 'version', undefined, 0);
    const map = hob.lookups.map(version, Date.now());
    if (!map) throw new Refusal(404, 'no-version', `${hob.name} has no lookup of version ${version} in the store`);
    return map;
  },
};

/** Water that comes to the boil within four minutes, as `/pot-temperature` answers it. */
function potCurve(startMs, nowMs) {
  const points = [];
  const rise = (s) => Math.min(96, 45 * (1 - Math.exp(-s / 20)) + 0.22 * s);
  for (let at_ms = Math.max(startMs, nowMs - 3600e3); at_ms <= nowMs; at_ms += 2000) {
    const rise_k = rise((at_ms - startMs) / 1000);
    points.push({ at_ms, rise_k, sigma_k: 1 + 0.12 * rise_k });
  }
  const last = points.at(-1);
  const boils = (nowMs - startMs) / 1000 > 300;
  const now = last && { since_ms: startMs, rise_k: last.rise_k, sigma_k: last.sigma_k, prior_k: 1.3 * last.rise_k, prior_sigma_k: 20 + 0.5 * last.rise_k, lift_mm: 0.02, lift_sigma_mm: 0.04, bubbles: last.rise_k >= 96, boils, overheats: false };
  return { now: now ?? null, points };
}

function journal(daemon, query) {
  const [since, before] = [number(query, 'since', -Infinity), number(query, 'before', Infinity)];
  const [device, kind] = [query.get('device'), query.get('kind')];
  const wanted = (e) => (!device || e.device === device) && (!kind || e.kind === kind) && e.at_ms >= since && e.at_ms < before;
  return daemon.journal.filter(wanted).slice(-number(query, 'limit', 200, 1, 10000)).reverse();
}

function download(daemon, response, name, query) {
  const recording = daemon.recordings.find((r) => r.file === name);
  if (!recording) throw new Refusal(404, 'no-recording', `there is no recording ${name}`);
  const format = query.get('format') ?? 'mcap';
  const types = { mcap: 'application/octet-stream', csv: 'text/csv', npz: 'application/zip' };
  if (!types[format]) throw new Refusal(400, 'query', 'format: mcap, csv or npz');
  const hob = daemon.named(recording.device);
  const file = name.replace(/mcap$/, format);
  response.writeHead(200, { 'content-type': types[format], 'content-disposition': `attachment; filename="${file}"` });
  if (format !== 'csv') {
    const magic = format === 'mcap' ? '894d434150300d0a' : '504b0304';
    const body = Buffer.alloc(Math.min(recording.bytes, 65536), 0);
    for (let k = 0; k < body.length; k++) body[k] = hash(hob.seed, k) & 255;
    Buffer.from(magic, 'hex').copy(body);
    return response.end(body);
  }
  const window = windowAsked(hob, new URLSearchParams());
  const { rate, v, i } = samplesOf(hob, window);
  response.write('t_s,v_v,i_a\n');
  v.forEach((volt, k) => response.write(`${(k / rate).toFixed(9)},${volt.toFixed(4)},${i[k].toFixed(5)}\n`));
  return response.end();
}

/** What a test does to the fake daemon: `POST /fake/…`. */
export function mend(daemon, options, what, body) {
  const hob = () => daemon.named(body.device ?? daemon.hobs[0].name);
  switch (what) {
    case 'pot': {
      const pot = body.pot === 'none' ? null : body.pot ?? hob().pot0;
      hob().change({ pot });
      daemon.note(Date.now(), hob().name, 'pot', pot ? 'a pot stands on the coil' : 'the pot was taken away');
      return { pot };
    }
    case 'fault':
      daemon.fault(hob(), body.fault ?? 24);
      return { fault: hob().now.fault };
    case 'connected':
      Object.assign(hob(), { connected: body.connected, lostMs: Date.now(), connections: hob().connections + 1 });
      return { connected: hob().connected };
    case 'gone':
      // As a board on USB that is unplugged; with null they are all back.
      daemon.all ??= daemon.hobs;
      daemon.hobs = daemon.all.filter(({ name }) => name !== body.device);
      return { devices: daemon.hobs.length };
    case 'incompatible':
      hob().incompatible = body.incompatible ?? true;
      return { incompatible: hob().incompatible };
    case 'power':
      hob().change({ askedW: body.power_w });
      return { asked_w: body.power_w };
    case 'words':
      // What a hostile device or person wrote.
      Object.assign(hob(), { detailSaid: body.detail, buildSaid: body.build });
      if (body.journal) daemon.note(Date.now(), hob().name, 'command', body.journal, body.journal);
      return {};
    case 'fleet':
      return daemon.fleet.change(body);
    case 'store':
      // As a daemon's store that fails, and is well again with null.
      options.storeFailure = body.failure ?? null;
      daemon.tell(null, 'store', { ok: !body.failure, text: body.failure?.text ?? 'the store works again' });
      return { failure: options.storeFailure };
    case 'slow':
      options.slowMs = body.ms ?? 0;
      return { slow_ms: options.slowMs };
    case 'events':
      options.eventMs = body.ms ?? 0;
      return { event_ms: options.eventMs };
    case 'watchers':
      return { watchers: daemon.listenerCount('notice') };
    case 'silence':
      options.silentUntilMs = Date.now() + 1000 * (body.for_s ?? 5);
      return { silent_until_ms: options.silentUntilMs };
    case 'truth': {
      const { pot, stretch, heats, fSw, power, i, r, l } = hob().truth(hob().number(Date.now()));
      return { heats, pot: pot?.name ?? stretch.pot, asked_w: stretch.askedW, f_sw_hz: fSw, power_w: power, i_crest_a: i, r_ohm: r, l_h: l };
    }
    default:
      throw new Refusal(404, 'no-route', 'fake: pot, fault, connected, gone, incompatible, power, words, fleet, slow, events, silence, die, truth');
  }
}

/** Answers a request under /api/v1. */
export function api(daemon, tokens, options, request, response, path, query, body) {
  const reading = request.method === 'GET';
  const answer = (value) => json(response, 200, value);
  if (path[0] === 'session') return session(daemon, tokens, request, response, body);
  tokens.allow(request, reading ? 'read' : 'operate');
  if (path[0] === 'live' && reading) return watch(daemon, response, number(query, 'interval_ms', 200, 100, 5000), options);
  if (path[0] === 'hob') return answer(HOB);
  if (path[0] === 'fleet') {
    const report = daemon.fleet.report();
    if (!report) throw new Refusal(404, 'no-fleet', 'this daemon belongs to no fleet: [fleet] url in ihd.toml makes it an edge (docs/fleet.md)');
    return answer(report);
  }
  if (path[0] === 'journal') return answer(journal(daemon, query));
  if (path[0] === 'recordings') {
    const newest = [...daemon.recordings].sort((a, b) => b.at_ms - a.at_ms);
    return path[1] ? download(daemon, response, path[1], query) : answer(newest);
  }
  if (path[0] !== 'devices') throw new Refusal(404, 'no-route', 'there is nothing here; /api/v1/openapi.json lists what there is');
  if (path.length === 1) return answer(daemon.hobs.map((hob) => daemon.report(hob)));
  const hob = daemon.named(path[1]);
  if (path.length === 2) return answer(daemon.report(hob));
  if (reading && OF_A_DEVICE[path[2]]) return answer(OF_A_DEVICE[path[2]](daemon, hob, query));
  const holder = request.headers['ihd-holder']?.trim();
  if (!holder || holder.length > 64) throw new Refusal(400, 'holder', 'the header `ihd-holder` must say who asks, in 1 to 64 printable ASCII characters');
  if (path[2] === 'commands' && request.method === 'POST') return answer(daemon.command(hob, holder, body));
  if (path[2] === 'lease' && request.method === 'PUT') return answer(daemon.takeLease(hob, holder, body.force ?? false));
  if (path[2] === 'lease' && request.method === 'DELETE') {
    daemon.releaseLease(hob, holder);
    return json(response, 204);
  }
  throw new Refusal(405, 'method', 'not with this method; /api/v1/openapi.json lists what there is');
}

function session(daemon, tokens, request, response, body) {
  if (request.method === 'POST') return json(response, 204, undefined, tokens.begin(body.token));
  if (request.method === 'DELETE') return json(response, 204, undefined, Tokens.end());
  return json(response, 200, { role: tokens.role(request), token_needed: tokens.needed, fleet: daemon.fleet.report() !== null });
}

/** An answer in JSON. */
export function json(response, status, value, headers = {}) {
  response.writeHead(status, { 'content-type': 'application/json', 'cache-control': 'no-store', ...headers });
  response.end(value === undefined ? undefined : JSON.stringify(value));
}
