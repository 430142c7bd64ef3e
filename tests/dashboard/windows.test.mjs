// Many windows of one browser: they share one event stream, and each can switch off.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { Api } from './harness/api.mjs';
import { NO_DAEMON, browser, noProblems, open, value, watched } from './harness/browser.mjs';
import { Daemon, Fake, until } from './harness/processes.mjs';

/** More than a browser has connections to a host over HTTP/1.1. */
const WINDOWS = 8;

/** Waits until a page draws what it hears: R changes with each half-cycle. */
async function hears(page, what) {
  const seen = new Set();
  await until(what, async () => {
    seen.add(await value(page, 'r-now'));
    return seen.size > 2 && !(await page.getByTestId('stale').isVisible());
  });
}

test('eight windows share one stream, and Off in the last is acknowledged at its first try', async (t) => {
  const fake = await Fake.start(t, '--heating');
  const chromium = await browser(t);
  const first = await open(chromium, `${fake.url}/#/live/desk`);
  const pages = [first.page];
  const problems = [first.problems];
  const watchers = async () => (await fake.do('watchers')).watchers;
  while (pages.length < WINDOWS) {
    const page = await first.context.newPage();
    problems.push(watched(page));
    await page.goto(`${fake.url}/#/live/desk`);
    pages.push(page);
  }
  for (const page of pages) await hears(page, 'every window hears');
  assert.equal(await watchers(), 1);

  const last = pages.at(-1);
  // The page ends a try after 2.5 s: of its own clock, which stands still, and not of a busy machine's.
  await last.clock.install();
  await last.clock.pauseAt(await last.evaluate(() => Date.now() + 1000));
  const isCommand = (request) => request.method() === 'POST' && request.url().endsWith('/commands');
  const [firstTry] = await Promise.all([last.waitForRequest(isCommand), last.getByTestId('off').click()]);
  assert.equal(firstTry.postData(), '{"command":"off"}');
  assert.equal((await firstTry.response())?.status(), 200);
  await last.locator('.off-alarm.done').waitFor();
  await last.clock.resume();
  assert.equal((await fake.do('truth', { device: 'desk' })).asked_w, 0);

  // Whoever opened the stream goes, and those that are left still hear.
  await fake.do('power', { device: 'desk', power_w: 1000 });
  for (const page of pages.splice(0, 5)) await page.close();
  for (const page of pages) await hears(page, 'those that are left hear');
  assert.equal(await watchers(), 1);

  // The daemon dies and comes back.
  await fake.do('die', { for_s: 4 });
  for (const page of pages) await until('stale', () => page.getByTestId('stale').isVisible());
  for (const page of pages) await hears(page, 'they hear again');
  assert.equal(await watchers(), 1);
  for (const of of problems) noProblems(of, NO_DAEMON);
});

/** A benchmark of docs/daemon.md: it judges nothing by the clock. */
const measured = process.env.IHD_DASHBOARD_FULL === '1' ? test : test.skip;
const OFFS = 20;

measured('how long Off takes in the eighth window, from the click to the answer of the real daemon', async (t) => {
  const daemon = await Daemon.start(t, '[[device]]\nname = "inside"\naddress = "sim"\nsim = { pot = "ferritic-21", seed = 3 }\n');
  const api = new Api(daemon.url);
  await until('idle', async () => (await api.device('inside')).state === 'idle');
  const chromium = await browser(t);
  const { context, page: first } = await open(chromium, `${daemon.url}/#/live/inside`);
  const pages = [first];
  while (pages.length < WINDOWS) {
    pages.push(await context.newPage());
    await pages.at(-1).goto(`${daemon.url}/#/live/inside`);
  }
  const last = pages.at(-1);
  const took = [];
  while (took.length < OFFS) {
    const { status } = await api.command('inside', { command: 'power', power_w: 700 });
    assert.equal(status, 200);
    const pressed = await last.evaluate(() => {
      const at = Date.now();
      document.querySelector('[data-testid=off]').click();
      return at;
    });
    const answered = await until('off', async () => {
      const [command] = await api.get('/journal?device=inside&kind=command&limit=1');
      return /^off\b/.test(command?.text) && command.at_ms >= pressed && command.at_ms;
    });
    took.push(answered - pressed);
    await last.locator('.off-alarm.done').first().waitFor({ state: 'detached' });
  }
  took.sort((a, b) => a - b);
  t.diagnostic(`${OFFS} offs: median ${took[OFFS / 2]} ms, worst ${took.at(-1)} ms`);
});
