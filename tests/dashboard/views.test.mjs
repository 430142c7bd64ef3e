// Every view: nothing for axe-core, no scrolling sideways, no error, every hook; by keyboard alone.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { test } from 'node:test';

import { browser, noProblems, open, overhang, violations } from './harness/browser.mjs';
import { Fake, sleep, until } from './harness/processes.mjs';

const VIEWS = ['devices', 'live', 'map', 'training', 'events', 'recordings', 'fleet'];
const FULL = process.env.IHD_DASHBOARD_FULL === '1';
/** Theme and width; the full form has every pair. */
const LOOKS = FULL ? [['light', 1280], ['light', 360], ['dark', 1280], ['dark', 360]] : [['light', 1280], ['dark', 360]];
const WIDTHS = [360, 600, 1024, 1920, 3840];

/** Hooks of the issue, by the view that has them; `''` is every view. */
const HOOKS = {
  '': ['off', 'stale'],
  devices: ['device-2039344E5956', 'device-2039344E5A73'],
  live: ['power-input', 'power-set', 'r-now', 'l-now', 'p-now', 'pot-rise', 'pot-says', 'state', 'fault', 'pot', 'lookup-version'],
  map: ['map-cell-0-0', 'map-cell-7-16', 'map-cell-3-9'],
  training: [],
  events: ['events'],
  recordings: ['record-toggle'],
  fleet: ['fleet-windows', 'fleet-results', 'fleet-backlog', 'fleet-dead', 'fleet-outbox', 'fleet-worker-count', 'fleet-devices'],
};

const address = (url, view, device = 'desk') => `${url}/#/${view}${['devices', 'events', 'fleet'].includes(view) ? '' : `/${device}`}`;

/** Goes to a view and waits until it has drawn what it read. */
async function show(page, url, view, device) {
  await page.goto(address(url, view, device));
  await page.locator(`main .view-${view}`).waitFor();
  // What it reads first, and a second telemetry event.
  await sleep(700);
}

test('axe-core finds nothing in any view, light and dark', async (t) => {
  const fake = await Fake.start(t);
  await fake.do('fault', { device: 'lab-3', fault: 24 });
  const chromium = await browser(t);
  for (const [colorScheme, width] of LOOKS) {
    const { page, context, problems } = await open(chromium, fake.url, { colorScheme, viewport: { width, height: 900 } });
    for (const view of VIEWS) {
      await t.test(`${view}, ${colorScheme}, ${width} px`, async () => {
        await show(page, fake.url, view);
        assert.deepEqual(await violations(page), []);
      });
    }
    noProblems(problems);
    await context.close();
  }
  await t.test('and would find something', async () => {
    const { page, context } = await open(chromium, fake.url);
    // Beside the view, which may still be on its way.
    await page.evaluate(() => document.body.append(document.createElement('button')));
    assert.match((await violations(page)).join(), /button-name/);
    await context.close();
  });
});

test('questions can be read, answered and left by keyboard', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, fake.url, { colorScheme: 'dark' });
  const asking = [
    ['live', /^sweep/i],
    ['live', /^reset lookup/i],
    ['map', /^roll back/i],
  ];
  for (const [view, name] of asking) {
    await show(page, fake.url, view);
    const button = page.locator('button:enabled').filter({ hasText: name }).first();
    await button.focus();
    await page.keyboard.press('Enter');
    const dialog = page.getByRole('dialog');
    await dialog.waitFor();
    assert.deepEqual(await violations(page), [], `${view} ${name}`);
    // The focus is in it, and stays in it but for Off.
    for (let k = 0; k < 12; k++) {
      const where = await page.evaluate(() => document.activeElement.closest('[role=dialog], #header, #alarms') !== null || document.activeElement === document.body);
      assert.ok(where, `${view} ${name}: the focus left the question after ${k} tabs`);
      await page.keyboard.press('Tab');
    }
    await page.keyboard.press('Escape');
    await dialog.waitFor({ state: 'detached' });
    assert.ok(await button.evaluate((e) => e === document.activeElement), 'the focus is back');
  }
  noProblems(problems);
});

test('no view scrolls sideways from 360 to 3840 px', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, fake.url);
  for (const width of WIDTHS) {
    await page.setViewportSize({ width, height: Math.max(640, Math.round((width * 9) / 16)) });
    for (const view of VIEWS) {
      await t.test(`${view}, ${width} px`, async () => {
        await show(page, fake.url, view);
        assert.equal(await overhang(page), 0, 'pixels beyond the window');
      });
    }
  }
  noProblems(problems);
});

test('every hook of the issue is there, and numbers stand in SI units', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, fake.url);
  for (const view of VIEWS) {
    await show(page, fake.url, view);
    for (const hook of [...HOOKS[''], ...HOOKS[view]]) {
      assert.equal(await page.getByTestId(hook).count(), 1, `${hook} in ${view}`);
    }
  }
  await show(page, fake.url, 'map');
  for (let row = 0; row < 8; row++) {
    for (let column = 0; column < 17; column++) {
      assert.equal(await page.getByTestId(`map-cell-${row}-${column}`).count(), 1, `cell ${row} ${column}`);
    }
  }
  // The fake's pots have some ohm and some 25 µH at 1500 W.
  await show(page, fake.url, 'live');
  const si = { 'r-now': [1, 10], 'l-now': [10e-6, 60e-6], 'p-now': [1400, 1600] };
  for (const [hook, [low, high]] of Object.entries(si)) {
    const number = async () => Number(await page.getByTestId(hook).getAttribute('data-value'));
    await until(`${hook} between ${low} and ${high}`, async () => (await number()) > low && (await number()) < high);
  }
  noProblems(problems);
});

test('by keyboard alone: every control is reached, none holds the focus, and what is focused is seen', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, fake.url);
  for (const view of VIEWS) {
    await t.test(view, async () => {
      await show(page, fake.url, view);
      const { missed, unseen } = await walk(page);
      assert.deepEqual(missed, [], 'controls that Tab does not reach');
      assert.deepEqual(unseen, [], 'focused without showing it');
    });
  }
  noProblems(problems);
});

/** Tabs once around the page. */
async function walk(page) {
  await page.evaluate(() => {
    document.activeElement?.blur();
    // One of the radio buttons of a group, and one cell of a grid, stand for all.
    const controls = 'a[href], button, input, select, textarea, summary, [tabindex]';
    const shown = (e) => e.checkVisibility({ visibilityProperty: true }) && !e.closest('[inert]') && !e.disabled && e.tabIndex >= 0;
    globalThis.wanted = [...document.querySelectorAll(controls)].filter((e) => shown(e) && !(e.type === 'radio' && !e.checked));
    globalThis.reached = new Set();
    globalThis.unseen = [];
  });
  const most = await page.evaluate(() => 2 * globalThis.wanted.length + 20);
  // It begins where the focus was last: once past the end, and around.
  for (let k = 0; k < most; k++) {
    await page.keyboard.press('Tab');
    const back = await page.evaluate(() => {
      const now = document.activeElement;
      if (!now || now === document.body) return false;
      if (globalThis.reached.has(now)) return now === [...globalThis.reached][0];
      globalThis.reached.add(now);
      const style = getComputedStyle(now);
      const around = now.parentElement ? getComputedStyle(now.parentElement) : style;
      const seen = (style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) > 0) || style.boxShadow !== 'none' || around.outlineStyle !== 'none';
      if (!seen) globalThis.unseen.push(now.outerHTML.slice(0, 120));
      return false;
    });
    if (back) break;
  }
  return page.evaluate(() => ({
    missed: globalThis.wanted.filter((e) => e.isConnected && !globalThis.reached.has(e)).map((e) => e.outerHTML.slice(0, 120)),
    unseen: globalThis.unseen,
  }));
}

test('with 32 devices every view still works', async (t) => {
  const fake = await Fake.start(t, '--devices', '32', '--rate', '25', '--history', '60');
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, fake.url, { viewport: { width: 1024, height: 800 } });
  await show(page, fake.url, 'devices');
  assert.equal(await page.locator('[data-testid^="device-20"]').count(), 32);
  assert.equal(await overhang(page), 0);
  for (const view of VIEWS) await show(page, fake.url, view, 'hob-31');
  noProblems(problems);
});

test('what a device says is shown as text', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, fake.url);
  const attack = '<img src=x onerror="globalThis.owned=1">';
  await fake.do('words', { device: 'desk', detail: attack, build: attack, journal: attack });
  for (const view of VIEWS) {
    await show(page, fake.url, view);
    assert.equal(await page.evaluate(() => document.querySelectorAll('main img[src="x"]').length), 0, view);
  }
  assert.equal(await page.evaluate(() => globalThis.owned), undefined);
  await show(page, fake.url, 'events');
  assert.match(await page.getByTestId('events').innerText(), /<img src=x/);
  noProblems(problems);
});

test('every plot gives a picture and its numbers', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, fake.url);
  const least = { live: 14, map: 2, training: 2, events: 1 };
  for (const [view, number] of Object.entries(least)) {
    await t.test(view, async () => {
      await show(page, fake.url, view);
      // Until the scope has its window.
      await sleep(1500);
      const buttons = page.locator('main button:enabled').filter({ hasText: /^(PNG|CSV)$/ });
      const count = await buttons.count();
      assert.ok(count >= number, `${count} exports`);
      for (let k = 0; k < count; k++) {
        // Chromium drops the eleventh download of a burst, silently; a burst ends with a second without one.
        if (k % 8 === 7) await sleep(1200);
        const button = buttons.nth(k);
        const format = await button.innerText();
        const [download] = await Promise.all([page.waitForEvent('download'), button.click()]);
        const bytes = await readFile(await download.path());
        if (format === 'PNG') isPicture(bytes, download.suggestedFilename());
        else isTable(bytes.toString('utf8'), download.suggestedFilename());
      }
    });
  }
  noProblems(problems);
});

function isPicture(bytes, name) {
  assert.equal(bytes.subarray(0, 8).toString('hex'), '89504e470d0a1a0a', name);
  assert.ok(bytes.readUInt32BE(16) >= 300 && bytes.readUInt32BE(20) >= 100, `${name}: ${bytes.readUInt32BE(16)} x ${bytes.readUInt32BE(20)}`);
}

/** Remarks, a head with units, rows as wide as it, and no number that is none. */
function isTable(text, name) {
  const lines = text.trim().split(/\r?\n/);
  const remarks = lines.filter((line) => line.startsWith('#'));
  const [head, ...rows] = lines.filter((line) => !line.startsWith('#'));
  assert.ok(rows.length > 0, `${name}: no row`);
  const columns = fields(head).length;
  for (const row of rows) assert.equal(fields(row).length, columns, `${name}: ${row}`);
  assert.doesNotMatch(text, /\b(NaN|undefined|Infinity|null)\b/, name);
  // Events are words, and steps of the optimiser have no unit.
  if (!/event|steps/i.test(name)) {
    assert.match(head, /\/ ?[kmµ]?(s|A|V|W|Hz|ohm|Ω|H|°|%)(,|"|$)|_(s|A|V|W|Hz|ohm|H|pct)(,|$)/i, `${name}: no unit in: ${head}`);
    assert.ok(remarks.length > 0, `${name}: neither device nor time is named`);
  }
}

/** Of a line of CSV (RFC 4180). */
const fields = (line) => line.match(/("([^"]|"")*"|[^,]*)(,|$)/g).slice(0, line.endsWith(',') ? undefined : -1);

test('a tab has one connection for events, paused or not', async (t) => {
  const fake = await Fake.start(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, 'about:blank');
  const watchers = async () => (await fake.do('watchers')).watchers;
  for (const view of [...VIEWS, 'live']) {
    await show(page, fake.url, view);
    await until(`one connection at ${view}`, async () => (await watchers()) === 1);
  }
  await page.getByRole('button', { name: 'Pause', exact: true }).click();
  await sleep(4500);
  assert.equal(await page.getByTestId('stale').isVisible(), false, 'what is paused is not stale');
  assert.equal(await watchers(), 1);
  noProblems(problems);
});
