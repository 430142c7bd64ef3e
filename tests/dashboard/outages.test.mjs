// A daemon that is killed under an open page, a link that is slow, a daemon that says nothing.

import assert from 'node:assert/strict';
import { spawnSync } from 'node:child_process';
import { appendFile, readFile } from 'node:fs/promises';
import { join } from 'node:path';
import { test } from 'node:test';

import { Api } from './harness/api.mjs';
import { NO_DAEMON, browser, noProblems, open, value } from './harness/browser.mjs';
import { Daemon, Fake, Hob, Link, until } from './harness/processes.mjs';

const stale = (page) => page.getByTestId('stale').isVisible();

test('a daemon that is killed and comes back: stale, then fresh, and its past is still on the page', async (t) => {
  // It heats by itself, as at its panel, while nobody listens.
  const hob = await Hob.start(t, '--panel', '5', '--sim', 'seed=7');
  const daemon = await Daemon.start(t, `[[device]]\nname = "bench"\naddress = "tcp:${hob.address}"\n`);
  const api = new Api(daemon.url);
  await until('it heats', async () => (await api.device('bench')).live?.power_w > 500);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, `${daemon.url}/#/live/bench`);
  await until('power on the page', async () => (await value(page, 'p-now')) > 500);
  // Telemetry is written every 5 s, and a kill loses what is not (docs/daemon.md): some of it must be older than two of these.
  const rows = async () => (await api.get(`/devices/bench/history?from=${Date.now() - 60000}&to=${Date.now()}&columns=60`)).at_ms;
  await until('history that a kill does not lose', async () => Date.now() - (await rows())[0] > 12000);

  const killedMs = Date.now();
  await daemon.kill();
  await until('stale', () => stale(page));
  const staleS = (Date.now() - killedMs) / 1000;
  const backMs = Date.now();
  await daemon.run(t);
  await until('fresh again', async () => !(await stale(page)));
  const freshS = (Date.now() - backMs) / 1000;
  await until('it heats', async () => (await api.device('bench')).live?.power_w > 500);
  const heardMs = Date.now();
  await until('power on the page', async () => (await value(page, 'p-now')) > 500);
  t.diagnostic(`stale after ${staleS.toFixed(1)} s; fresh ${freshS.toFixed(1)} s after the daemon was started again`);

  // Without a reload the page shows what was before the outage, as the daemon has it, and what came after it. Its own export has what is seen.
  await until('rows of before the outage and of after it', async () => {
    const seen = await exported(page);
    return seen.some((ms) => ms < killedMs) && seen.filter((ms) => ms > heardMs).length >= 2;
  }, 500);
  noProblems(problems, NO_DAEMON);
});

/** Times of the rows of a plot's CSV, in milliseconds since 1970. */
async function exported(page) {
  const figure = page.locator('figure, section').filter({ hasText: /P|power/i }).filter({ has: page.getByRole('button', { name: /csv/i }) }).last();
  const [download] = await Promise.all([page.waitForEvent('download'), figure.getByRole('button', { name: /csv/i }).first().click()]);
  const rows = (await readFile(await download.path(), 'utf8')).split(/\r?\n/);
  const times = rows.map((row) => row.split(',')[0]).map((first) => (/^\d{4}-/.test(first) ? Date.parse(first) : Number(first)));
  return times.map((x) => (x > 1e9 && x < 1e11 ? x * 1000 : x)).filter((x) => x > 1.6e12);
}

test('whoever has no board and does what the page says has a hob on it', async (t) => {
  const daemon = await Daemon.start(t, '', { head: 'discover_usb = false' });
  const { page, problems } = await open(await browser(t), daemon.url, { permissions: ['clipboard-read', 'clipboard-write'] });
  const guide = page.getByTestId('first-run');
  await guide.waitFor();
  const texts = await guide.locator('code').allInnerTexts();
  // Every command is one of the program, with options that it has; the daemon's is the one that the test starts it with.
  const commands = texts.filter((text) => text.startsWith('ihd '));
  assert.ok(commands.includes('ihd trainer --daemon') && commands.includes('ihd doctor'), commands.join());
  for (const command of commands) {
    const words = command.split(' ').slice(1);
    const { status, stderr } = spawnSync(process.env.IHD_BIN, [...words, '--help'], { encoding: 'utf8' });
    assert.equal(status, 0, `${command}: ${stderr}`);
  }
  await page.getByRole('button', { name: /^Copy \[\[device\]\]/ }).click();
  await until('copied', async () => (await page.evaluate(() => navigator.clipboard.readText())).startsWith('[[device]]'));
  const copied = await page.evaluate(() => navigator.clipboard.readText());
  await daemon.kill();
  await appendFile(join(daemon.folder, 'ihd.toml'), `\n${copied}\n`);
  await daemon.run(t);
  // The same page, not loaded again.
  await page.locator('.device').filter({ hasText: 'simulated' }).filter({ hasText: 'idle' }).waitFor();
  assert.equal(await guide.isVisible(), false);
  noProblems(problems, NO_DAEMON);
});

test('a daemon that says nothing is stale after three seconds, and fresh when it speaks', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, `${fake.url}/#/live/desk`);
  await until('power on the page', async () => (await value(page, 'p-now')) > 1000);
  await until('it is fresh', async () => !(await stale(page)));
  await fake.do('silence', { for_s: 5 });
  await until('stale', () => stale(page), 50);
  await until('fresh', async () => !(await stale(page)));
  noProblems(problems);
});

test('on a slow link the newest is shown, and that some was left out', async (t) => {
  const hob = await Hob.start(t);
  // Idle, fifteen others cost little and fill the buffers of a slow link in two seconds.
  const others = Array.from({ length: 15 }, (_, k) => `[[device]]\nname = "sim-${k}"\naddress = "sim"\n`).join('');
  const daemon = await Daemon.start(t, `[[device]]\nname = "bench"\naddress = "tcp:${hob.address}"\n${others}`);
  const api = new Api(daemon.url);
  await until('all are there', async () => (await api.get('/devices')).every((d) => d.state === 'idle'));
  const link = await Link.start(t, daemon.port);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, `${link.url}/#/live/bench`);
  await until('no power on the page', async () => (await value(page, 'p-now')) === 0);
  link.limit(SLOW_BYTES_S);
  await until('intervals are left out', () => page.getByTestId('skipped').isVisible());
  // How old is what the page shows? Power, and when the page shows it.
  hob.event('panel = 5');
  await until('power in the daemon', async () => (await api.device('bench')).live.power_w > 500);
  const begun = Date.now();
  await until('power on the page', async () => (await value(page, 'p-now')) > 500);
  t.diagnostic(`at ${SLOW_BYTES_S / 1000} kB/s the page shows power ${((Date.now() - begun) / 1000).toFixed(1)} s after the daemon`);
  assert.equal(await page.getByTestId('skipped').isVisible(), true, 'that intervals were left out');
  t.diagnostic(await page.getByTestId('skipped').innerText());
  hob.event('panel = 0');
  link.limit(0);
  await until('nothing is left out any more', async () => !(await page.getByTestId('skipped').isVisible()));
  await until('it is fresh', async () => !(await stale(page)));
  noProblems(problems);
});

/** Half of what sixteen devices take, in bytes a second. */
const SLOW_BYTES_S = 15000;

test('slow answers hold nothing up: the live numbers go on', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, `${fake.url}/#/live/desk`);
  await until('power on the page', async () => (await value(page, 'p-now')) > 1000);
  await fake.do('slow', { ms: 3000 });
  const seen = new Set();
  await until('eight different powers', async () => seen.add(await value(page, 'p-now')).size >= 8, 50);
  assert.equal(await stale(page), false);
  noProblems(problems);
});

test('a store that fails stands as a banner, also on a page that is opened later, until it is well again', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const early = await open(chromium, fake.url);
  const banner = (of) => of.page.getByTestId('store-failure');
  await until('the page', () => early.page.locator('main .view').first().isVisible());
  assert.equal(await banner(early).isVisible(), false);
  const dropped = { windows: 3, results: 0, telemetry_s: 0, events: 0, audits: 0 };
  await fake.do('store', { failure: { cause: 'disk-full', text: "the store's disk is full", advice: 'Free space.', since_ms: Date.now(), dropped } });
  const late = await open(chromium, fake.url);
  for (const seen of [early, late]) {
    await until('the banner', () => banner(seen).isVisible());
    assert.match(await banner(seen).textContent(), /disk is full.*3 windows.*Free space/s);
  }
  await fake.do('store', { failure: null });
  for (const seen of [early, late]) {
    await until('no banner', async () => !(await banner(seen).isVisible()));
    noProblems(seen.problems, /503/);
  }
});
