// What a person does at the page, against the real daemon with two simulated hobs: one in the daemon itself, whose truth
// the daemon knows, and one behind TCP, whose pot can be lifted. What became of it is asked of the daemon, not of the page.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { after, before, describe, test } from 'node:test';

import { Api } from './harness/api.mjs';
import { browser, noProblems, open, value } from './harness/browser.mjs';
import { Daemon, Hob, sleep, until } from './harness/processes.mjs';

const FULL = process.env.IHD_DASHBOARD_FULL === '1';

/** Ends with the whole file: a test's own context has an end of its own. */
const life = { ends: [], after: (end) => life.ends.unshift(end) };
let daemon, hob, api, chromium, page, context, problems;

const devices = (hobAddress) => `
[[device]]
name = "inside"
address = "sim"
sim = { pot = "ferritic-21", seed = 3 }

[[device]]
name = "bench"
address = "tcp:${hobAddress}"
`;

before(async () => {
  hob = await Hob.start(life, '--pot', 'cast-iron-21', '--sim', 'seed=5');
  daemon = await Daemon.start(life, devices(hob.address));
  api = new Api(daemon.url);
  chromium = await browser(life);
  await until('both hobs idle', async () => (await api.get('/devices')).every((d) => d.state === 'idle'));
  ({ page, context, problems } = await open(chromium, `${daemon.url}/#/live/inside`));
});
after(async () => {
  for (const end of life.ends) await end();
});

/** The page has heard that nobody else holds the lease: before that it asks whether to take it over. */
const isFree = async (on) => {
  const says = on.getByTestId('power-says');
  await until('nobody else commands', async () => /^(Set|This page) heats/.test(await says.innerText()));
};

/** Types a power into the page and sets it, once the lease is free. */
async function setPower(on, watt) {
  await isFree(on);
  await takeOver(on, watt);
}

/** Types a power into the page and sets it, whoever holds the lease. */
async function takeOver(on, watt) {
  await on.getByTestId('power-input').fill(String(watt));
  await on.getByTestId('power-set').click();
}

const asked = async (name) => (await api.device(name)).live?.asked_w;
// A simulated hob keeps real time only where the machine does: on a busy one it starts late.
const heats = (name, watt) => until(`${name} heats with ${watt} W`, async () => (await asked(name)) === watt).catch(async (error) => {
  const alerts = await page.getByRole('alert').allInnerTexts();
  throw new Error(`${error.message}; the page says ${JSON.stringify(alerts)}, the daemon ${JSON.stringify(await api.device(name))}`);
});
const isOff = async (name) => {
  const d = await api.device(name);
  return d.asked_by_daemon_w === 0 && d.live.asked_w === 0 && d.live.f_sw_hz === 0;
};
/** The word of the API that stands beside what the page says. */
const word = (on, testid) => on.getByTestId(testid).first().getAttribute('data-value');
/** R, L and where they are from, as the page shows them at one moment. */
const readNow = (on) => on.evaluate(() => {
  const at = (id) => document.querySelector(`[data-testid=${id}]`);
  const number = (id) => Number(at(id).dataset.value || NaN);
  const { value, window } = at('source').dataset;
  return { r: number('r-now'), l: number('l-now'), source: value, window };
});
const within = (a, b, share) => Math.abs(a / b - 1) <= share;

describe('acts', () => {
  test('power set at the page heats, and R and L are shown within 1 % of the truth', async (t) => {
    await setPower(page, 1200);
    await heats('inside', 1200);
    assert.equal((await api.device('inside')).asked_by_daemon_w, 1200);
    await until('p-now near 1200 W', async () => within(await value(page, 'p-now'), 1200, 0.05));
    // Control is done when two windows in a row have one frequency and one truth.
    let last = null;
    await until('a steady load', async () => {
      const scope = await api.get('/devices/inside/window?columns=1');
      const steady = last && scope.seq > last.seq && scope.f_sw_hz === last.f_sw_hz && within(scope.r_true_mean_ohm, last.r_true_mean_ohm, 0.002);
      if (!last || scope.seq > last.seq) last = scope;
      return steady;
    }, 300);
    // The page says which window R and L are of: one of the steady load, and the truth's mean is that window's.
    const shown = await until('a result of the network of the steady load', async () => {
      const seen = await readNow(page);
      return seen.source === 'network' && Number(seen.window.split('/')[1]) >= last.seq && seen;
    });
    const [boot, seq] = shown.window.split('/');
    const scope = await api.get(`/devices/inside/window?columns=1&boot=${boot}&seq=${seq}`);
    const truth = { r: scope.r_true_mean_ohm, l: scope.l_true_mean_h };
    assert.ok(within(scope.f_sw_hz, last.f_sw_hz, 0.01), `shown is a window of ${scope.f_sw_hz} Hz, steady are ${last.f_sw_hz} Hz`);
    t.diagnostic(`R ${shown.r.toFixed(4)} of ${truth.r.toFixed(4)} ohm, L ${(shown.l * 1e6).toFixed(3)} of ${(truth.l * 1e6).toFixed(3)} µH`);
    assert.ok(within(shown.r, truth.r, 0.01), `R ${shown.r} ohm, in truth ${truth.r}`);
    assert.ok(within(shown.l, truth.l, 0.01), `L ${shown.l} H, in truth ${truth.l}`);
  });

  test('more than the rating is the rating, and the page says so', async () => {
    const { rated_power_w: rated } = await api.get('/hob');
    await setPower(page, 3000);
    await heats('inside', rated);
    await until('the page says both', async () => (await page.getByTestId('power-says').innerText()).includes(`${rated} W, the most it gives (3000 W asked)`));
    assert.equal((await api.device('inside')).asked_by_daemon_w, rated);
    await setPower(page, 1200);
    await heats('inside', 1200);
  });

  test('Escape switches off', async () => {
    await heats('inside', 1200);
    await page.locator('body').click({ position: { x: 5, y: 300 } });
    await page.keyboard.press('Escape');
    await until('inside off', () => isOff('inside'));
  });

  test('the off button switches off, though somebody else commands', async () => {
    const other = new Api(daemon.url, { 'ihd-holder': 'ada' });
    // The page gives its lease back after the answer to its off.
    await until('nobody holds the lease', async () => !(await api.device('inside')).lease);
    const { status, body } = await other.command('inside', { command: 'power', power_w: 700 });
    assert.equal(status, 200, JSON.stringify(body));
    await heats('inside', 700);
    await page.getByTestId('off').click();
    await until('inside off', () => isOff('inside'));
    await other.ask('/devices/inside/lease', { method: 'DELETE' });
  });

  test('the keyboard sets power', async () => {
    await isFree(page);
    const input = page.getByTestId('power-input');
    await input.focus();
    await input.fill('');
    await page.keyboard.type('900');
    await page.keyboard.press('Enter');
    await heats('inside', 900);
    await page.keyboard.press('Escape');
    await until('inside off', () => isOff('inside'));
  });

  test('a pot that is lifted is seen, and one that comes back', async () => {
    await page.goto(`${daemon.url}/#/live/bench`);
    await setPower(page, 1000);
    await heats('bench', 1000);
    await until('the page says that it heats', async () => (await word(page, 'state')) === 'learning');
    hob.event('pot = "none"');
    await until('the page says that it waits', async () => (await word(page, 'state')) === 'waiting-for-pot');
    await until('the page says that there is no pot', async () => (await word(page, 'pot')) === 'Absent');
    assert.match(await page.getByTestId('state').innerText(), /waiting for pot/i);
    assert.equal((await api.device('bench')).state, 'waiting-for-pot');
    hob.event('pot = "cast-iron-21"');
    await until('the page says that it heats again', async () => (await word(page, 'state')) === 'learning');
    await until('the page says that there is a pot', async () => (await word(page, 'pot')) === 'Ferromagnetic');
    await page.keyboard.press('Escape');
    await until('bench off', () => isOff('bench'));
  });

  test('a second page takes over, and the first says so', async () => {
    await page.goto(`${daemon.url}/#/live/inside`);
    await setPower(page, 600);
    await heats('inside', 600);
    const second = await open(chromium, `${daemon.url}/#/live/inside`);
    await takeOver(second.page, 800);
    const dialog = second.page.getByRole('dialog');
    await dialog.waitFor();
    await dialog.locator('button.danger, button.strong').first().click();
    await heats('inside', 800);
    await page.getByRole('alert').filter({ hasText: /inside/ }).first().waitFor();
    assert.equal((await api.device('inside')).asked_by_daemon_w, 800, 'the first page must not take it back');
    await second.page.keyboard.press('Escape');
    await until('inside off', () => isOff('inside'));
    noProblems(second.problems, /423/);
    await second.context.close();
    await page.getByRole('button', { name: 'Close' }).first().click();
  });

  for (const [how, end, tier] of [
    ['closed', (other) => other.close(), test],
    ['crashed', (other) => crash(other), test],
    // Its lease ends as a crashed tab's does.
    ['frozen', (other) => freeze(other), FULL ? test : test.skip],
  ]) {
    tier(`a tab that is ${how}: off when its lease runs out`, async (t) => {
      // Of its own renderer: a process shared with `page` would take that along.
      const other = await open(chromium, `${daemon.url}/#/live/inside`);
      await setPower(other.page, 500);
      await heats('inside', 500);
      // Renewed: what is left of it falls, and is whole again.
      const left = async () => (await api.device('inside')).lease?.expires_in_s;
      if (how === 'closed') for (const whole of [false, true]) await until('it is renewed', async () => (await left()) > 9 === whole);
      const begun = Date.now();
      await end(other.page);
      await until('inside off', () => isOff('inside'), 50);
      t.diagnostic(`off ${((Date.now() - begun) / 1000).toFixed(1)} s after the tab was ${how}`);
      await other.context.close();
    });
  }

  test('a lookup is rolled back', async () => {
    // Two learned versions at least: what one power taught, and what another did. The page rolls back to none that came with the device.
    await page.goto(`${daemon.url}/#/live/inside`);
    const used = async () => (await api.get('/devices/inside/lookups')).filter((row) => row.version > 0 && ['active', 'superseded'].includes(row.state)).length;
    const learned = async () => (await api.device('inside')).windows.learned;
    for (const watt of [1700, 900, 2200, 600]) {
      if ((await used()) >= 2) break;
      await setPower(page, watt);
      await heats('inside', watt);
      const enough = (await learned()) + 5;
      await until(`five windows learned with ${watt} W`, async () => (await learned()) >= enough || (await used()) >= 2);
    }
    assert.ok((await used()) >= 2, 'two lookups after four powers');
    await page.keyboard.press('Escape');
    await until('inside off', () => isOff('inside'));
    const before = await until('no lookup on its way', async () => {
      const { lookup } = await api.device('inside');
      return lookup.pending === null && lookup.on_device === lookup.active && lookup;
    });
    await page.goto(`${daemon.url}/#/map/inside`);
    await page.locator('button:enabled').filter({ hasText: /^roll back/i }).first().click();
    const dialog = page.getByRole('dialog');
    await dialog.waitFor();
    await dialog.locator('button.danger, button.strong').first().click();
    // The learner may still build one of the windows of before: of the newer versions, the one that says so is the rolled back one.
    const rolled = (row) => row.version > before.on_device && row.state !== 'pending' && /^rolled back to version (\d+)/.exec(row.why);
    const rows = await until('the version that was rolled back to', async () => {
      const rows = await api.get('/devices/inside/lookups');
      return rows.some(rolled) && rows;
    });
    const row = rows.find(rolled);
    const cells = (row) => row.blob.slice(9, -4).join();
    assert.equal(cells(row), cells(rows.find(({ version }) => version === Number(rolled(row)[1]))));
    await page.goto(`${daemon.url}/#/live/inside`);
    await until('lookup-version on the page', async () => (await value(page, 'lookup-version')) === (await api.device('inside')).lookup.on_device);
  });

  test('a recording is made and downloaded', async (t) => {
    await page.goto(`${daemon.url}/#/live/inside`);
    await setPower(page, 1100);
    await heats('inside', 1100);
    await page.goto(`${daemon.url}/#/recordings/inside`);
    await page.getByTestId('record-toggle').click();
    const file = await until('a file', async () => (await api.device('inside')).recording);
    const newest = async () => (await api.get('/devices/inside/window?columns=1')).seq;
    const first = await newest();
    await until('two windows more', async () => (await newest()) >= first + 2);
    await page.getByTestId('record-toggle').click();
    await until('no more recording', async () => (await api.device('inside')).recording === null);
    await page.keyboard.press('Escape');
    const name = file.split('/').pop();
    const magics = { mcap: '894d434150300d0a', npz: '504b0304', csv: null };
    for (const [format, magic] of Object.entries(magics)) {
      const link = page.locator('tr, li, article', { hasText: name }).getByText(format.toUpperCase(), { exact: true }).first();
      const [download] = await Promise.all([page.waitForEvent('download'), link.click()]);
      const bytes = await readFile(await download.path());
      t.diagnostic(`${download.suggestedFilename()}: ${bytes.length} bytes`);
      assert.ok(bytes.length > 10000, format);
      if (magic) assert.equal(bytes.subarray(0, magic.length / 2).toString('hex'), magic, format);
    }
  });

  test('none of it made an error in the page', () => noProblems(problems, /423/));
});

/** The tab's renderer dies. */
async function crash(other) {
  const cdp = await other.context().newCDPSession(other);
  cdp.send('Page.crash').catch(() => {});
  await sleep(100);
}

/** The page's own thread hangs for good; its worker goes on. */
async function freeze(other) {
  other.evaluate(() => setTimeout(() => { for (;;); }, 0)).catch(() => {});
  await sleep(50);
}
