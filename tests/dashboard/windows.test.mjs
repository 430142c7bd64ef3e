// Many windows of one browser: they share one event stream, and each can switch off.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { NO_DAEMON, browser, noProblems, open, value, watched } from './harness/browser.mjs';
import { Fake, until } from './harness/processes.mjs';

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
  const tries = [];
  last.on('request', (request) => {
    if (request.method() === 'POST' && request.url().endsWith('/commands')) tries.push(request.postData());
  });
  await last.getByTestId('off').click();
  await last.locator('.off-alarm.done').waitFor();
  assert.deepEqual(tries, ['{"command":"off"}']);
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
