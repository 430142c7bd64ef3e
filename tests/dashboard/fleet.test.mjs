// The fleet's page against the fake daemon, which is an edge of a fleet of any size, and against a real one that is none.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { after, before, test } from 'node:test';

import { Api } from './harness/api.mjs';
import { browser, noProblems, open, overhang, violations } from './harness/browser.mjs';
import { Daemon, Fake, until } from './harness/processes.mjs';

const SILENT_MS = 30_000;

/** Ends with the whole file: one browser and one fake daemon do for all. */
const life = { ends: [], after: (end) => life.ends.unshift(end) };
let fake, api, chromium;

before(async () => {
  fake = await Fake.start(life, '--devices', '1', '--history', '60', '--fleet', '0');
  api = new Api(fake.url);
  chromium = await browser(life);
});
after(async () => {
  for (const end of life.ends) await end();
});

/** The page of a fleet of so many hobs. */
async function shown(t, hobs) {
  await fake.do('fleet', { devices: hobs, connected: true, words: null });
  const { page, context, problems } = await open(chromium, `${fake.url}/#/fleet`);
  t.after(() => context.close());
  if (hobs > 0) await page.getByTestId('fleet-count').waitFor();
  return { page, problems };
}

const table = (page) => page.getByTestId('fleet-devices');
const names = (page) => table(page).locator('tbody th').allInnerTexts();
const count = async (page) => Number(await page.getByTestId('fleet-count').getAttribute('data-value'));
const column = async (page, k) => (await table(page).locator(`tbody:not(.fleet-spacer) tr :nth-child(${k})`).allInnerTexts());

test('a thousand hobs: only those in view are there, and every one is reached', async (t) => {
  const { page, problems } = await shown(t, 1000);
  const report = await api.get('/fleet');
  for (const [hook, key] of [['windows', 'windows'], ['results', 'results'], ['dead', 'dead'], ['outbox', 'outbox']]) {
    const value = Number(await page.getByTestId(`fleet-${hook}`).getAttribute('data-value'));
    assert.ok(Math.abs(value - report[key]) <= 40, `${hook}: ${value}, the API says ${report[key]}`);
  }
  assert.equal(await page.getByTestId('fleet-worker-count').getAttribute('data-value'), String(report.workers.length));
  assert.equal(await page.getByTestId('fleet-workers').locator('tbody th').count(), report.workers.length);
  assert.equal(await table(page).locator('table').getAttribute('aria-rowcount'), '1001');
  const rows = await table(page).locator('tbody:not(.fleet-spacer) tr').count();
  assert.ok(rows > 5 && rows < 80, `${rows} rows for 1000 hobs`);

  // Long tasks of the page while it is scrolled and sorted: told, not judged.
  await page.evaluate(() => {
    globalThis.longest = 0;
    new PerformanceObserver((list) => list.getEntries().forEach((e) => (globalThis.longest = Math.max(globalThis.longest, e.duration)))).observe({ entryTypes: ['longtask'] });
  });
  const { holes, wrong, last } = await table(page).evaluate(beforeOnesEyes);
  assert.deepEqual([holes, wrong, last], [[], [], 'hob-999']);
  // By keyboard, too.
  await table(page).evaluate((e) => (e.scrollTop = 0));
  await until('the first', async () => (await names(page))[0] === 'hob-0', 20);
  await table(page).focus();
  await page.keyboard.press('End');
  await until('the last', async () => (await names(page)).includes('hob-999'), 20);
  assert.equal(await table(page).locator('tbody:not(.fleet-spacer) tr').last().getAttribute('aria-rowindex'), '1001');

  // Sorted: hob-10 after hob-9; outdated first by firmware; the newest lookups first, downwards.
  await table(page).getByRole('button', { name: 'Lookup' }).click();
  await table(page).getByRole('button', { name: 'Lookup' }).click();
  await until('sorted downwards', async () => (await table(page).locator('thead th').nth(6).getAttribute('aria-sort')) === 'descending', 20);
  const lookups = (await column(page, 7)).map(Number);
  assert.deepEqual(lookups, [...lookups].sort((a, b) => b - a));
  assert.equal(lookups[0], Math.max(...report.devices.map((d) => d.lookup_version)));
  assert.equal(await table(page).evaluate((e) => e.scrollTop), 0);
  t.diagnostic(`${rows} rows there; longest task ${(await page.evaluate(() => globalThis.longest)).toFixed(0)} ms (0: none over 50 ms)`);
  noProblems(problems);
});

test('text, outdated only, silent only, and the file of what is seen', async (t) => {
  const { page, problems } = await shown(t, 300);
  const { devices } = await api.get('/fleet');
  const silent = (d) => Date.now() - d.last_seen_ms > SILENT_MS;
  const choose = async (what, wanted) => {
    await until(`${what}: ${wanted}`, async () => (await count(page)) === wanted, 30);
    assert.ok(wanted > 0, `${what} lets some through`);
  };
  await page.getByTestId('fleet-outdated').check();
  await choose('outdated only', devices.filter((d) => d.outdated).length);
  assert.ok((await column(page, 5)).every((text) => /outdated/.test(text)));
  await page.getByTestId('fleet-silent').check();
  await choose('outdated and silent', devices.filter((d) => d.outdated && silent(d)).length);
  await page.getByTestId('fleet-outdated').uncheck();
  await choose('silent only', devices.filter(silent).length);
  assert.ok((await column(page, 8)).every((text) => /^silent for/.test(text)));
  await page.getByTestId('fleet-silent').uncheck();
  await page.getByTestId('fleet-filter').fill('KITCHEN-3 faulted');
  const wanted = devices.filter((d) => d.edge.includes('kitchen-3') && d.state === 'faulted');
  await choose('a text', wanted.length);
  const [download] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'Save the devices' }).click()]);
  const lines = (await readFile(await download.path(), 'utf8')).trim().split(/\r?\n/).filter((line) => !line.startsWith('#'));
  assert.deepEqual(lines.slice(1).map((line) => line.split(',')[0]).sort(), wanted.map((d) => d.name).sort());
  await page.getByTestId('fleet-filter').fill('no such hob');
  await until('none', async () => (await count(page)) === 0, 30);
  assert.match(await page.locator('main').innerText(), /No device is of this kind/);
  noProblems(problems);
});

test('where the server is gone it says why, and the ages count on', async (t) => {
  const { page, problems } = await shown(t, 40);
  const server = page.getByTestId('fleet-server');
  assert.equal(await server.getAttribute('data-value'), 'true');
  await fake.do('fleet', { connected: false, why: 'connection refused' });
  await until('it says so', async () => (await server.getAttribute('data-value')) === 'false');
  assert.match(await server.innerText(), /not connected to tls:\/\/nats\.example:4222: connection refused/);
  const age = async () => Number(/(\d+)\s*s old/.exec(await page.getByTestId('fleet-age').innerText())?.[1]);
  const first = await until('numbers of some seconds', age);
  await until('and older', async () => (await age()) > first);
  // The hobs were heard of at most 10 s before: all of them become silent without anybody saying so. Their clock is the daemon's.
  assert.match((await column(page, 8)).join(), /ago/);
  await fake.do('fleet', { connected: true });
  await until('and back', async () => (await server.getAttribute('data-value')) === 'true');
  noProblems(problems);
});

test('the states of this edge\'s windows are there, and what needs somebody', async (t) => {
  const { page, problems } = await shown(t, 8);
  const alarms = page.getByTestId('fleet-alarms');
  assert.equal(await alarms.isVisible(), false);
  for (const state of ['not_for_fleet', 'learned_here', 'no_samples', 'dead']) {
    const { states } = await api.get('/fleet');
    assert.equal(await page.getByTestId(`fleet-state-${state}`).getAttribute('data-value'), String(states[state]));
  }
  const texts = ['3 windows are due, the first for 14 min', '<b>the edge name "lab-1" belongs to another</b>'];
  await fake.do('fleet', { alarms: texts });
  await until('the alarms', async () => (await alarms.locator('li').allInnerTexts()).join() === texts.join());
  await fake.do('fleet', { alarms: [] });
  await until('none', async () => !(await alarms.isVisible()));
  noProblems(problems);
});

test('what other machines call themselves is shown as text', async (t) => {
  const { page, problems } = await shown(t, 24);
  const attack = '<img src=x onerror="globalThis.owned=1">';
  const hostile = [attack, '__proto__', `\u202e${'x'.repeat(300)}`];
  await fake.do('fleet', { words: { names: hostile, build: attack } });
  for (const list of ['workers', 'edges', 'devices']) {
    const rows = page.getByTestId(`fleet-${list}`).locator('tbody th');
    await until(`${list} by their names`, async () => {
      const there = await rows.allInnerTexts();
      return hostile.every((name) => there.includes(name));
    });
  }
  // Words of the filter are a text, too.
  await page.getByTestId('fleet-filter').fill(attack);
  await until('those whose firmware is called so', async () => (await count(page)) === hostile.length, 30);
  assert.deepEqual((await names(page)).sort(), [...hostile].sort());
  assert.equal(await overhang(page), 0);
  assert.equal(await page.locator('main img').count(), 0);
  assert.deepEqual(await violations(page), []);
  assert.equal(await page.evaluate(() => globalThis.owned), undefined);
  noProblems(problems);
});

test('a daemon without a fleet has no way to the page, and the page says how there would be one', async (t) => {
  const daemon = await Daemon.start(t, '[[device]]\nname = "inside"\naddress = "sim"\nsim = { pot = "ferritic-21", seed = 3 }\n');
  const real = new Api(daemon.url);
  assert.equal((await real.get('/session')).fleet, false);
  const { status, body } = await real.ask('/fleet');
  assert.deepEqual([status, body.error], [404, 'no-fleet']);
  const { page, problems } = await open(chromium, daemon.url);
  await page.locator('#views a[data-view=devices]').waitFor();
  assert.equal(await page.locator('#views a[data-view=fleet]').isVisible(), false);
  await page.goto(`${daemon.url}/#/fleet`);
  await page.getByText(body.message.slice(1)).waitFor();
  noProblems(problems);
});

test('a daemon that becomes an edge shows the way', async (t) => {
  const { page, problems } = await shown(t, 0);
  const link = page.locator('#views a[data-view=fleet]');
  await page.getByText('belongs to no fleet').waitFor();
  assert.equal(await link.isVisible(), false);
  await fake.do('fleet', { devices: 3 });
  await until('the way', () => link.isVisible());
  await until('the hobs', async () => (await count(page)) === 3);
  await fake.do('fleet', { devices: 0 });
  await page.getByText('belongs to no fleet').waitFor();
  noProblems(problems, /404/);
});

/** In the page: the table is scrolled from its beginning to its end. Where a place had no row, which row was another's, and the last. */
async function beforeOnesEyes(box) {
  const drawn = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  const [holes, wrong] = [[], []];
  for (box.scrollTop = 0; ; box.scrollTop += 2.7 * box.clientHeight) {
    await drawn();
    const { top, bottom, left } = box.getBoundingClientRect();
    const head = box.querySelector('thead').getBoundingClientRect().height;
    for (let y = top + head + 3; y < Math.min(bottom, innerHeight) - 3; y += 9) {
      const row = document.elementFromPoint(left + 20, y)?.closest('tbody:not(.fleet-spacer) tr');
      if (!row) holes.push(`${box.scrollTop} + ${y - top}`);
      // Sorted by name, which people count: hob-7 is the eighth, below the head.
      else if (row.firstChild.innerText !== `hob-${row.getAttribute('aria-rowindex') - 2}`) wrong.push(row.innerText);
    }
    if (box.scrollTop + box.clientHeight >= box.scrollHeight - 1) break;
  }
  return { holes, wrong, last: [...box.querySelectorAll('tbody th')].at(-1).innerText };
}
