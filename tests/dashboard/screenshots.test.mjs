// The pictures of docs/daemon.md, of the real daemon with two simulated hobs: `IHD_SCREENSHOTS=docs/dashboard`.

import assert from 'node:assert/strict';
import { mkdir, writeFile } from 'node:fs/promises';
import { join } from 'node:path';
import { test } from 'node:test';

import { Api } from './harness/api.mjs';
import { browser, noProblems, open } from './harness/browser.mjs';
import { withPalette } from './harness/png.mjs';
import { Daemon, Fake, Hob, sleep, until } from './harness/processes.mjs';

const FOLDER = process.env.IHD_SCREENSHOTS;
/** Powers that teach enough of the map to be looked at, in watt. */
const SWEEP = [2400, 2000, 1600, 1300, 1000, 750, 1400, 1800];
const STEP_S = Number(process.env.IHD_SCREENSHOTS_STEP_S ?? 9);
const MOST_BYTES = 150_000;

const PICTURES = [
  ['devices', 'devices', 'light', 1280, 480],
  ['live', 'live/bench', 'light', 1280, 1250],
  ['live-dark', 'live/bench', 'dark', 1280, 640],
  ['live-phone', 'live/bench', 'light', 360, 740],
  ['map', 'map/bench', 'light', 1280, 860],
  ['training', 'training/bench', 'light', 1280, 860],
  ['events', 'events', 'light', 1280, 560],
  ['recordings', 'recordings/bench', 'light', 1280, 560],
];
/** Of a fleet, which no single machine has. */
const PICTURES_OF_A_FLEET = [
  ['fleet', 'fleet', 'light', 1280, 800],
  ['fleet-dark', 'fleet', 'dark', 1280, 640],
];

test('pictures for the documentation', { skip: FOLDER ? false : 'with --screenshots alone' }, async (t) => {
  const hob = await Hob.start(t, '--pot', 'cast-iron-21', '--sim', 'warming,seed=2', '--panel', '6');
  const devices = `
[[device]]
name = "bench"
address = "sim"
sim = { pot = "ferritic-21", warming = true, seed = 1 }
[[device]]
name = "desk"
address = "tcp:${hob.address}"
`;
  const daemon = await Daemon.start(t, devices);
  const ada = new Api(daemon.url, { 'ihd-holder': 'ada' });
  await until('both hobs', async () => (await ada.get('/devices')).every((d) => d.live));
  const record = (command) => ada.command('bench', { command });
  const lease = () => ada.ask('/devices/bench/lease', { method: 'PUT', headers: { 'content-type': 'application/json' }, body: '{}' });
  await lease();
  const renewed = setInterval(() => lease().catch(() => {}), 3000);
  t.after(() => clearInterval(renewed));
  for (const [k, power] of SWEEP.entries()) {
    const { status, body } = await ada.command('bench', { command: 'power', power_w: power });
    assert.equal(status, 200, JSON.stringify(body));
    if (k === 2) hob.event('pot = { name = "none", for_s = 3 }');
    if (k === 3 || k === 5) await record('record-start');
    await sleep(STEP_S * 1000);
    if (k === 3 || k === 5) await record('record-stop');
  }
  await pictures(t, daemon.url, PICTURES);
});

test('pictures of a fleet, which the fake daemon alone has', { skip: FOLDER ? false : 'with --screenshots alone' }, async (t) => {
  const fake = await Fake.start(t, '--devices', '1', '--fleet', '1000');
  await pictures(t, fake.url, PICTURES_OF_A_FLEET);
});

/** Each into the folder: name, view, theme, width and height. */
async function pictures(t, url, wanted) {
  await mkdir(FOLDER, { recursive: true });
  const chromium = await browser(t);
  for (const [name, view, colorScheme, width, height] of wanted) {
    const { page, context, problems } = await open(chromium, `${url}/#/${view}`, { colorScheme, viewport: { width, height } });
    if (view.startsWith('live')) await page.getByRole('button', { name: '1 min', exact: true }).click();
    await sleep(5000);
    await page.evaluate(() => scrollTo(0, 0));
    const picture = withPalette(await page.screenshot({ fullPage: name === 'map' || name === 'training' }));
    await writeFile(join(FOLDER, `${name}.png`), picture);
    t.diagnostic(`${name}.png: ${Math.round(picture.length / 1000)} kB`);
    assert.ok(picture.length < MOST_BYTES, `${name}.png has ${picture.length} bytes`);
    noProblems(problems);
    await context.close();
  }
}
