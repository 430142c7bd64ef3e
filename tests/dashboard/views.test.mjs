// Every view: nothing for axe-core, no scrolling sideways, no error, every hook; by keyboard alone. One fake daemon and one page serve
// all of it, in a light and wide pass and a dark and narrow one.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { after, before, test } from 'node:test';

import { browser, noProblems, open, overhang, settled, violations } from './harness/browser.mjs';
import { Fake, sleep, until } from './harness/processes.mjs';

const VIEWS = ['devices', 'live', 'map', 'training', 'events', 'recordings', 'fleet'];
const FULL = process.env.IHD_DASHBOARD_FULL === '1';
/** Theme and width; the full form has every pair. */
const LOOKS = FULL ? [['light', 1280], ['light', 360], ['dark', 1280], ['dark', 360]] : [['light', 1280], ['dark', 360]];
const WIDTHS = [360, 600, 1024, 1920, 3840];

/** Hooks by the view that has them; `''` is every view. */
const HOOKS = {
  '': ['off', 'stale'],
  devices: ['device-2039344E5956', 'device-2039344E5A73'],
  live: ['power-input', 'power-set', 'r-now', 'l-now', 'p-now', 'pot-rise', 'pot-says', 'state', 'fault', 'pot', 'lookup-version'],
  map: Array.from({ length: 8 * 17 }, (_, k) => `map-cell-${Math.floor(k / 17)}-${k % 17}`),
  training: [],
  events: ['events'],
  recordings: ['record-toggle'],
  fleet: ['fleet-windows', 'fleet-results', 'fleet-backlog', 'fleet-dead', 'fleet-outbox', 'fleet-worker-count', 'fleet-devices'],
};

/** Ends with the whole file. */
const life = { ends: [], after: (end) => life.ends.unshift(end) };
let fake, chromium;

before(async () => {
  fake = await Fake.start(life);
  await fake.do('fault', { device: 'lab-3', fault: 24 });
  chromium = await browser(life);
});
after(async () => {
  for (const end of life.ends) await end();
});

const address = (url, view, device = 'desk') => `${url}/#/${view}${['devices', 'events', 'fleet'].includes(view) ? '' : `/${device}`}`;

/** Goes to a view and waits until it has drawn what it read. */
async function show(page, url, view, device) {
  await page.goto(address(url, view, device));
  await page.locator(`main .view-${view}`).waitFor();
  await settled(page);
}

const ATTACK = '<img src=x onerror="globalThis.owned=1">';

for (const [pass, [colorScheme, width]] of LOOKS.entries()) {
  test(`every view, ${colorScheme}, ${width} px: axe-core, hooks, keyboard, and words of a device as text`, async (t) => {
    // What a hostile device says is looked at in the second pass.
    if (pass === 1) await fake.do('words', { device: 'desk', detail: ATTACK, build: ATTACK, journal: ATTACK });
    const { page, context, problems } = await open(chromium, fake.url, { colorScheme, viewport: { width, height: 900 } });
    for (const view of VIEWS) {
      await t.test(view, async () => {
        await show(page, fake.url, view);
        const found = await violations(page);
        assert.deepEqual(found, []);
        assert.equal(await overhang(page), 0, 'pixels beyond the window');
        const hooks = [...HOOKS[''], ...HOOKS[view]];
        const counts = await page.evaluate((ids) => ids.map((id) => document.querySelectorAll(`[data-testid="${id}"]`).length), hooks);
        assert.deepEqual(counts.filter((n) => n !== 1), [], `${hooks} once each in ${view}`);
        assert.equal(await page.locator('main img[src="x"]').count(), 0);
        if (pass === 1 && view === 'events') assert.match(await page.getByTestId('events').innerText(), /<img src=x/);
        if (pass === 0) {
          const { missed, unseen } = await walk(page);
          assert.deepEqual(missed, [], 'controls that Tab does not reach');
          assert.deepEqual(unseen, [], 'focused without showing it');
        }
        await until('one connection for events', async () => (await fake.do('watchers')).watchers === 1);
      });
    }
    assert.equal(await page.evaluate(() => globalThis.owned), undefined);
    noProblems(problems);
    await context.close();
  });
}

test('axe-core would find something', async () => {
  const { page, context } = await open(chromium, fake.url);
  // Beside the view, which may still be on its way.
  await page.evaluate(() => document.body.append(document.createElement('button')));
  assert.match((await violations(page)).join(), /button-name/);
  await context.close();
});

test('no view scrolls sideways from 360 to 3840 px, and every plot gives a picture and its numbers', async (t) => {
  const { page, context, problems } = await open(chromium, fake.url);
  const least = { live: 14, map: 2, training: 2, events: 1 };
  for (const view of VIEWS) {
    await t.test(view, async () => {
      await show(page, fake.url, view);
      for (const width of WIDTHS) {
        await page.setViewportSize({ width, height: Math.max(640, Math.round((width * 9) / 16)) });
        await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
        assert.equal(await overhang(page), 0, `pixels beyond the window of ${width}`);
      }
      await page.setViewportSize({ width: 1280, height: 800 });
      if (least[view]) await exports(page, least[view]);
    });
  }
  noProblems(problems);
  await context.close();
});

/** Presses every export of a view and looks at what it saves. */
async function exports(page, least) {
  const buttons = page.locator('main button:enabled').filter({ hasText: /^(PNG|CSV)$/ });
  await until(`${least} exports`, async () => (await buttons.count()) >= least);
  const count = await buttons.count();
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
}

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

test('questions can be read, answered and left by keyboard', async () => {
  const { page, context, problems } = await open(chromium, fake.url, { colorScheme: 'dark' });
  const asking = [
    ['live', /^sweep/i],
    ['live', /^reset lookup/i],
    ['map', /^roll back/i],
  ];
  for (const [view, name] of asking) {
    await show(page, fake.url, view);
    const button = page.locator('button:enabled').filter({ hasText: name }).first();
    const dialog = page.getByRole('dialog');
    // A view that is drawn again meanwhile has another button.
    await until('the question is asked', async () => {
      await button.focus();
      await page.keyboard.press('Enter');
      return dialog.isVisible();
    });
    assert.deepEqual(await violations(page), [], `${view} ${name}`);
    // The focus is in it, and stays in it but for Off.
    for (let k = 0; k < 12; k++) {
      const where = await page.evaluate(() => document.activeElement.closest('[role=dialog], #header, #alarms') !== null || document.activeElement === document.body);
      assert.ok(where, `${view} ${name}: the focus left the question after ${k} tabs`);
      await page.keyboard.press('Tab');
    }
    await page.keyboard.press('Escape');
    await dialog.waitFor({ state: 'detached' });
    await until('the focus is back', () => button.evaluate((e) => e === document.activeElement));
  }
  noProblems(problems);
  await context.close();
});

/** The map of a version, which heating does not change, as the daemon tells it and as it is shown. */
async function mapOfVersion(page, version) {
  await show(page, fake.url, 'map');
  await chooseVersion(page, version);
  await until('it is shown', async () => (await page.locator('.map-title strong').innerText()).endsWith(`version ${version}`));
  return (await fetch(`${fake.url}/api/v1/devices/desk/map?version=${version}`)).json();
}

const chooseVersion = (page, version) => page.locator('.map-tools select').nth(1).selectOption(String(version));

test('the map tells how far each cell may be off, in percent, and which are known by that', async () => {
  const { page, context, problems } = await open(chromium, fake.url);
  const map = await mapOfVersion(page, 3);
  const cells = page.locator('.heatmap-cell');
  const seen = () => cells.evaluateAll((all) => all.map((c) => ({ f: +c.dataset.f, i: +c.dataset.i, value: Number(c.dataset.value ?? NaN), hatched: c.dataset.hatch !== '', text: c.innerText })));
  const quantity = page.getByLabel('Quantity');
  for (const [name, letter, most] of [['σ of R', 'r', 3], ['σ of L', 'l', 1.5]]) {
    await quantity.selectOption({ label: name });
    for (const { f, i, value, hatched, text } of await seen()) {
      const told = map[`sigma_${letter}_pct`][f][i];
      assert.ok(Math.abs(value - told) < 1e-9 && value > 0, `${name} of ${f}, ${i}: ${value}, not ${told}`);
      assert.ok(Math.abs(Number(text) / told - 1) < 0.06 || told < 0.1, `${text} for ${told} %`);
      assert.equal(hatched, value > most, `${name} of ${f}, ${i} is ${value} %: known or not`);
    }
    assert.match(await page.locator('.map-bar').getAttribute('aria-label'), new RegExp(`^Colours from [\\d.]+ to [\\d.]+: ${name} / %$`));
  }
  // Beside R and L of the cell that is looked at, and in the file.
  await page.getByTestId('map-cell-3-9').hover();
  const near = (pct) => `±\\s${pct.toFixed(pct < 0.995 ? 2 : pct < 9.95 ? 1 : 0)}\\s%`;
  const [r, l] = [map.sigma_r_pct[3][9], map.sigma_l_pct[3][9]];
  assert.match(await page.locator('.map-readout').innerText(), new RegExp(`Ω\\s${near(r)}[^]*H\\s${near(l)}`));
  const [download] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'Save the map as CSV' }).click()]);
  const [head, ...rows] = (await readFile(await download.path(), 'utf8')).trim().split(/\r?\n/).filter((line) => !line.startsWith('#'));
  const column = fields(head).findIndex((name) => name.startsWith('sigma_r_pct'));
  assert.ok(Math.abs(parseFloat(fields(rows[3 * 17 + 9])[column]) / r - 1) < 1e-3, `${head}\n${rows[3 * 17 + 9]}`);
  // Of the built-in map nobody can tell, and it says so; it shows no colours for nothing.
  await chooseVersion(page, 0);
  await until('why there is none', async () => /is a guess/.test(await page.locator('.map-state').innerText()));
  assert.equal(await page.locator('.map-bar').isVisible(), false);
  assert.ok((await seen()).every(({ value, text }) => Number.isNaN(value) && text === '–'));
  noProblems(problems);
  await context.close();
});

test('on a phone: every view within reach, and the map with its legend, its numbers and the touched cell in view at once', async () => {
  const { page, context, problems } = await open(chromium, fake.url, { viewport: { width: 390, height: 844 }, hasTouch: true });
  const map = await mapOfVersion(page, 3);
  const inView = (locator) => locator.evaluate((e) => {
    const { left, right, top, bottom, width } = e.getBoundingClientRect();
    return width > 0 && left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight;
  });
  for (const width of [360, 390, 500]) {
    await page.setViewportSize({ width, height: 844 });
    await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => { scrollTo(0, 0); done(); }))));
    const links = await page.locator('#views a').all();
    assert.equal(links.length, VIEWS.length);
    for (const link of links) {
      assert.ok(await inView(link), `${await link.innerText()} at ${width} px`);
      // Nothing lies over it, and a finger finds it.
      assert.ok(await link.evaluate((e) => {
        const { left, top, width: w, height } = e.getBoundingClientRect();
        return height >= 24 && w >= 24 && document.elementFromPoint(left + w / 2, top + height / 2) === e;
      }), `${await link.innerText()} at ${width} px`);
    }
    await page.getByLabel('Quantity').selectOption('r');
    for (const [f, i] of [[0, 16], [3, 9], [7, 2]]) {
      const cell = page.getByTestId(`map-cell-${f}-${i}`);
      await cell.tap();
      const picked = page.getByTestId('map-picked');
      const r = map.r_ohm[f][i].toPrecision(4);
      assert.match(await picked.innerText(), new RegExp(`^Chosen cell: .*\\sA · R\\s${r}\\sΩ\\s±`), `cell ${f}, ${i} at ${width} px`);
      for (const part of [cell, picked, page.locator('.map-bar')]) assert.ok(await inView(part), `cell ${f}, ${i}, its value and the legend at ${width} px`);
    }
    for (const quantity of await page.getByLabel('Quantity').locator('option').evaluateAll((all) => all.map((o) => o.value))) {
      await page.getByLabel('Quantity').selectOption(quantity);
      const cut = await page.locator('.heatmap-cell').evaluateAll((all) => all.filter((c) => c.innerText === '' || c.scrollWidth > c.clientWidth).map((c) => c.innerText));
      assert.deepEqual(cut, [], `numbers of ${quantity} that do not fit at ${width} px`);
    }
  }
  noProblems(problems);
  await context.close();
});

test('without a device the page says how to begin, until one is there', async () => {
  const none = await Fake.start(life, '--devices', '0');
  for (const [colorScheme, width] of LOOKS) {
    const { page, context, problems } = await open(chromium, none.url, { colorScheme, viewport: { width, height: 844 }, permissions: ['clipboard-read', 'clipboard-write'] });
    const guide = page.getByTestId('first-run');
    await guide.waitFor();
    assert.equal(await page.getByTestId('device-chooser').isVisible(), false);
    assert.deepEqual(await violations(page), []);
    assert.equal(await overhang(page), 0);
    // What is copied is what is read.
    for (const command of await guide.locator('.first-command').all()) {
      await command.getByRole('button', { name: 'Copy' }).click();
      const text = await command.locator('code').innerText();
      await until(`copied: ${text}`, async () => (await page.evaluate(() => navigator.clipboard.readText())) === text);
    }
    // Whoever came in by another view finds it.
    for (const view of ['live', 'map', 'training']) {
      await page.goto(`${none.url}/#/${view}`);
      await page.getByRole('link', { name: 'How to begin' }).click();
      await guide.waitFor();
    }
    noProblems(problems);
    await context.close();
  }
  const { page, context } = await open(chromium, address(fake.url, 'devices'));
  await page.locator('.device').first().waitFor();
  assert.equal(await page.getByTestId('first-run').isVisible(), false);
  assert.equal(await page.getByTestId('device-chooser').isVisible(), true);
  await context.close();
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

test('numbers stand in SI units, and plots that are paused hide nothing', async () => {
  const { page, context, problems } = await open(chromium, address(fake.url, 'live'));
  // The fake's pots have some ohm and some 25 µH at 1500 W.
  const si = { 'r-now': [1, 10], 'l-now': [10e-6, 60e-6], 'p-now': [1400, 1600] };
  for (const [hook, [low, high]] of Object.entries(si)) {
    const number = async () => Number(await page.getByTestId(hook).getAttribute('data-value'));
    await until(`${hook} between ${low} and ${high}`, async () => (await number()) > low && (await number()) < high);
  }
  await page.getByRole('button', { name: 'Pause', exact: true }).click();
  const pot = () => page.getByTestId('pot').getAttribute('data-value');
  const device = new URL(page.url()).hash.split('/').at(-1);
  await fake.do('pot', { device, pot: 'none' });
  await until('that the pot is gone is shown all the same', async () => (await pot()) === 'Absent');
  await fake.do('pot', { device });
  noProblems(problems);
  await context.close();
});

test('Off ends what the slider was about to send', async () => {
  const { page, context, problems } = await open(chromium, address(fake.url, 'live'));
  const sent = [];
  page.on('request', (request) => request.method() !== 'GET' && sent.push(`${request.method()} ${request.postData() ?? ''}`));
  await page.getByTestId('power-input').fill('800');
  await page.getByTestId('power-set').click();
  await until('the page heats', async () => (await page.getByTestId('power-says').getAttribute('data-value')) === 'held');
  await page.clock.install();
  await page.getByTestId('power-slider').focus();
  await page.keyboard.press('ArrowRight');
  await page.keyboard.press('Escape');
  await until('off is sent', async () => sent.some((one) => one.includes('"off"')));
  sent.length = 0;
  await page.clock.runFor(2000);
  assert.deepEqual(sent.filter((one) => !one.startsWith('DELETE')), []);
  noProblems(problems);
  await context.close();
});

test('with 32 devices every view still works', async () => {
  const many = await Fake.start(life, '--devices', '32', '--rate', '25', '--history', '60');
  const { page, context, problems } = await open(chromium, many.url, { viewport: { width: 1024, height: 800 } });
  await show(page, many.url, 'devices');
  assert.equal(await page.locator('[data-testid^="device-20"]').count(), 32);
  assert.equal(await overhang(page), 0);
  for (const view of VIEWS) await show(page, many.url, view, 'hob-31');
  noProblems(problems);
  await context.close();
});
