// Server-Sent Events of the fake daemon: for each watcher what was least and most since his last event, newest wins.

import { tank } from './history.mjs';

const DEVICES_MS = 2000;
const QUIET_MS = 1000;

/** Serves one watcher until he goes. `eventMs` overrides the interval that he asked for. */
export function watch(daemon, response, intervalMs, options) {
  response.writeHead(200, { 'content-type': 'text/event-stream', 'cache-control': 'no-store' });
  const send = (event, data) => response.write(`event: ${event}\ndata: ${JSON.stringify(data)}\n\n`);
  response.write(': watching\n\n');
  const seen = new Map(daemon.hobs.map((hob) => [hob, hob.number(Date.now())]));
  let [skipped, missed, devicesAt, telemetryAt, devicesWas] = [0, 0, 0, 0, ''];
  const telemetry = (nowMs) => {
    const devices = {};
    for (const hob of daemon.hobs) {
      const last = hob.number(nowMs);
      const first = Math.max(seen.get(hob) + 1, last - 2000);
      if (!hob.connected || last < first) continue;
      devices[hob.name] = { ...extremes(hob, first, last), skipped, last: hob.live(nowMs) };
      seen.set(hob, last);
    }
    if (Object.keys(devices).length === 0 && nowMs - telemetryAt < QUIET_MS) return;
    telemetryAt = nowMs;
    skipped = 0;
    send('telemetry', { at_ms: nowMs, devices });
  };
  const devices = (nowMs) => {
    const reports = daemon.hobs.map((hob) => daemon.report(hob, nowMs));
    const lasting = JSON.stringify(reports, (key, value) => (['live', 'since_s', 'expires_in_s', 'windows'].includes(key) ? undefined : value));
    if (lasting === devicesWas && nowMs - devicesAt < DEVICES_MS) return;
    [devicesAt, devicesWas] = [nowMs, lasting];
    send('devices', reports);
  };
  const timer = setInterval(() => {
    const nowMs = Date.now();
    if (options.silentUntilMs > nowMs) return;
    if (response.writableNeedDrain) {
      skipped += 1;
      return;
    }
    if (missed) send('missed', { missed });
    missed = 0;
    devices(nowMs);
    telemetry(nowMs);
  }, options.eventMs || Math.min(5000, Math.max(100, intervalMs)));
  const notice = (what) => {
    if (options.silentUntilMs > Date.now()) return;
    if (response.writableNeedDrain) missed += 1;
    else send('notice', what);
  };
  daemon.on('notice', notice);
  response.on('close', () => {
    clearInterval(timer);
    daemon.off('notice', notice);
  });
}

function extremes(hob, first, last) {
  const range = () => [Infinity, -Infinity];
  const found = { power_w: range(), r_ohm: range(), l_h: range(), f_sw_hz: range() };
  const take = (name, value) => {
    if (value === null) return;
    found[name][0] = Math.min(found[name][0], value);
    found[name][1] = Math.max(found[name][1], value);
  };
  let final = null;
  for (let n = first; n <= last; n++) {
    final = hob.halfCycle(n);
    take('power_w', final.powerW);
    take('r_ohm', final.rOhm);
    take('l_h', final.lH);
    take('f_sw_hz', final.fSwHz || null);
  }
  const [phase, resonance] = tank(final.rOhm, final.lH, final.fSwHz || null);
  for (const name of Object.keys(found)) if (found[name][0] === Infinity) found[name] = null;
  return { half_cycles: last - first + 1, phase_deg: phase, resonance_hz: resonance, ...found };
}
