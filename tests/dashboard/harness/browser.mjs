// A real Chromium, and pages in it whose errors fail the test.

import { createRequire } from 'node:module';
import { readFile } from 'node:fs/promises';
import { resolve } from 'node:path';

import { PATIENCE_MS } from './processes.mjs';

// npm's packages lie in target/dashboard: an import would look for them beside this file.
const modules = process.env.IHD_DASHBOARD_MODULES;
const require = createRequire(modules ? `${resolve(modules)}/` : import.meta.url);
const { chromium } = require('playwright-core');

const EXECUTABLE = process.env.IHD_CHROMIUM ?? '/usr/bin/chromium';

/** A browser for a test, closed at its end. */
export async function browser(t, ...args) {
  // A sandbox cannot be had by root, nor in most containers; what is looked at is this project's own page.
  const started = await chromium.launch({ executablePath: EXECUTABLE, args: ['--no-sandbox', ...args] });
  t.after(() => started.close());
  return started;
}

/** A page of a context of its own. `problems` collects what no page may have: errors, violations of its policy. */
export async function open(of, url, options = {}) {
  const context = await of.newContext({ viewport: { width: 1280, height: 800 }, acceptDownloads: true, ...options });
  context.setDefaultTimeout(PATIENCE_MS);
  const page = await context.newPage();
  const problems = watched(page);
  await page.goto(url);
  return { context, page, problems };
}

/** Collects errors of a page from now on. */
export function watched(page) {
  const problems = [];
  page.on('console', (message) => {
    if (message.type() !== 'error' && !/content.security.policy/i.test(message.text())) return;
    problems.push(`console: ${message.text()} (${message.location().url})`);
  });
  page.on('pageerror', (error) => problems.push(`exception: ${error.stack ?? error.message}`));
  page.on('crash', () => problems.push('the page crashed'));
  return problems;
}

/** Fails where a page had errors but those that a test causes itself. */
export function noProblems(problems, ...caused) {
  const left = problems.filter((text) => !caused.some((pattern) => pattern.test(text)));
  if (left.length) throw new Error(`the page had errors:\n  ${left.join('\n  ')}`);
}

/** Errors that a browser logs by itself when a daemon is not there. */
export const NO_DAEMON = /ERR_CONNECTION_REFUSED|ERR_CONNECTION_RESET|ERR_EMPTY_RESPONSE|ERR_INCOMPLETE_CHUNKED|ERR_CONNECTION_CLOSED|ERR_SOCKET_NOT_CONNECTED/;

/** Of an element: its number in SI units, or null. */
export async function value(page, testid) {
  const text = await page.getByTestId(testid).first().getAttribute('data-value', { timeout: 2000 });
  return text === null || text === '' ? null : Number(text);
}

/** Violations that axe-core finds, in words. */
export async function violations(page) {
  axe ??= await readFile(require.resolve('axe-core/axe.min.js'), 'utf8');
  // By the debugger's protocol, which no policy of the page concerns.
  await page.evaluate(axe);
  const found = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ['violations'] }));
  return found.violations.map(({ id, impact, help, nodes }) => {
    const where = nodes.slice(0, 3).map((n) => `${n.target.join(' ')}: ${n.any[0]?.message ?? n.all[0]?.message ?? n.none[0]?.message ?? ''}`);
    return `${id} (${impact}, ${nodes.length} places): ${help}: ${where.join('; ')}`;
  });
}
let axe;

/** Waits until a page has asked nothing for a while and has drawn the answers; its event stream does not count. */
export async function settled(page, quietMs = 150) {
  const asks = (request) => /\/api\/v1\//.test(request.url()) && !request.url().includes('/live');
  let [pending, sinceMs] = [0, Date.now()];
  const begun = (request) => asks(request) && (pending++, (sinceMs = Date.now()));
  const ended = (request) => asks(request) && ((pending = Math.max(0, pending - 1)), (sinceMs = Date.now()));
  page.on('request', begun).on('requestfinished', ended).on('requestfailed', ended);
  while (pending > 0 || Date.now() - sinceMs < quietMs) await new Promise((done) => setTimeout(done, 30));
  page.off('request', begun).off('requestfinished', ended).off('requestfailed', ended);
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
}

/** How far a page is wider than its window, in pixel: 0 where nothing scrolls sideways. */
export function overhang(page) {
  return page.evaluate(() => {
    const root = document.scrollingElement;
    return Math.max(0, root.scrollWidth - root.clientWidth);
  });
}
