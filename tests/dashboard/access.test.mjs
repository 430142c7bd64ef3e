// Who gets in: a token, its role, and pages of other sites.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import { createServer } from 'node:http';
import { join } from 'node:path';
import { test } from 'node:test';

import { Api } from './harness/api.mjs';
import { browser, noProblems, open } from './harness/browser.mjs';
import { Daemon, until } from './harness/processes.mjs';

const SIM = '[[device]]\nname = "inside"\naddress = "sim"\n';
/** What a browser logs by itself of an answer that refuses. */
const REFUSED = /status of 40[13]/;

async function withTokens(t, devices = SIM) {
  const daemon = await Daemon.start(t, devices, { head: 'token_file = "tokens"' });
  const lines = (await readFile(join(daemon.folder, 'tokens'), 'utf8')).split('\n').map((line) => line.trim().split(/\s+/));
  const tokens = Object.fromEntries(lines.filter(([role, token]) => token && !role.startsWith('#')));
  return { daemon, tokens };
}

test('with a token one gets in, stays in over a reload, and out again', async (t) => {
  const { daemon, tokens } = await withTokens(t);
  const chromium = await browser(t);
  const { page, context, problems } = await open(chromium, `${daemon.url}/#/live/inside`);
  await page.getByTestId('token').fill('wrong');
  await page.keyboard.press('Enter');
  await page.getByRole('alert').filter({ hasText: /token/i }).first().waitFor();
  await page.getByTestId('token').fill(tokens.operate);
  await page.keyboard.press('Enter');
  await page.getByTestId('power-input').waitFor();
  await page.reload();
  await page.getByTestId('power-input').waitFor();
  const [cookie] = await context.cookies();
  assert.deepEqual([cookie.name, cookie.httpOnly, cookie.sameSite], ['ihd-session', true, 'Strict']);
  assert.equal(await page.evaluate(() => document.cookie), '', 'no script reads it');
  assert.ok(!page.url().includes(tokens.operate));

  await page.getByTestId('power-input').fill('700');
  await page.getByTestId('power-set').click();
  const api = new Api(daemon.url, { authorization: `Bearer ${tokens.operate}` });
  await until('it heats', async () => (await api.device('inside')).live?.asked_w === 700);
  await page.keyboard.press('Escape');
  await until('off', async () => (await api.device('inside')).live?.asked_w === 0);

  await page.getByRole('button', { name: /log out/i }).click();
  await page.getByTestId('token').waitFor();
  assert.equal((await context.cookies()).length, 0);
  noProblems(problems, REFUSED);
});

/** Shows the token to a page that asks for it. */
async function logIn(page, token) {
  await page.getByTestId('token').fill(token);
  await page.keyboard.press('Enter');
  await page.getByTestId('power-input').waitFor();
}

test('logging out switches off first what all pages of the session heat, and all of them ask for a token', async (t) => {
  const { daemon, tokens } = await withTokens(t, SIM + SIM.replace('inside', 'other'));
  const api = new Api(daemon.url, { authorization: `Bearer ${tokens.operate}` });
  const asked = async () => (await api.get('/devices')).map((device) => device.asked_by_daemon_w);
  const { page, context, problems } = await open(await browser(t), `${daemon.url}/#/live/inside`);
  await logIn(page, tokens.operate);
  const second = await context.newPage();
  await second.goto(`${daemon.url}/#/live/other`);
  for (const one of [page, second]) {
    await one.getByTestId('power-input').fill('700');
    await one.getByTestId('power-set').click();
  }
  await until('both heat', async () => (await asked()).every((w) => w === 700));
  await page.getByRole('button', { name: /log out/i }).click();
  await page.getByTestId('token').waitFor();
  assert.deepEqual(await asked(), [0, 0]);
  await second.getByTestId('token').waitFor();
  // The cookie of one is the other's.
  await logIn(page, tokens.operate);
  await second.getByTestId('power-input').waitFor();
  noProblems(problems, REFUSED);
});

test('Off after the end of the session asks for a token, and is carried out with it', async (t) => {
  const { daemon, tokens } = await withTokens(t);
  const api = new Api(daemon.url, { authorization: `Bearer ${tokens.operate}`, 'content-type': 'application/json' });
  const { page, context, problems } = await open(await browser(t), `${daemon.url}/#/live/inside`);
  await logIn(page, tokens.operate);
  assert.equal((await api.command('inside', { command: 'power', power_w: 600 })).status, 200);
  const [{ name, value }] = await context.cookies();
  await fetch(`${daemon.url}/api/v1/session`, { method: 'DELETE', headers: { cookie: `${name}=${value}` } });
  await page.keyboard.press('Escape');
  const alarm = page.locator('.off-alarm');
  await alarm.filter({ hasText: 'log in again' }).waitFor();
  assert.doesNotMatch(await alarm.innerText(), /by itself/);
  await logIn(page, tokens.operate);
  // The other client renews: nothing but Off ends it.
  await until('off', async () => {
    await api.ask('/devices/inside/lease', { method: 'PUT', body: '{}' });
    return (await api.device('inside')).asked_by_daemon_w === 0;
  });
  // After Off the page releases its lease, and the other client has one again.
  noProblems(problems, /status of (40[13]|423)/);
});

test('who may only read sees everything and cannot act', async (t) => {
  const { daemon, tokens } = await withTokens(t);
  const chromium = await browser(t);
  const { page, problems } = await open(chromium, `${daemon.url}/#/live/inside`);
  await page.getByTestId('token').fill(tokens.read);
  await page.keyboard.press('Enter');
  await page.getByTestId('power-set').waitFor();
  assert.equal(await page.getByTestId('power-set').isDisabled(), true);
  const status = await page.evaluate(async () => {
    const headers = { 'content-type': 'application/json', 'ihd-holder': 'x' };
    const answer = await fetch('/api/v1/devices/inside/commands', { method: 'POST', headers, body: '{"command":"power","power_w":500}' });
    return answer.status;
  });
  assert.equal(status, 403);
  for (const view of ['devices', 'map/inside', 'training/inside', 'events', 'recordings/inside']) {
    await page.goto(`${daemon.url}/#/${view}`);
    await page.locator(`main .view-${view.split('/')[0]}`).waitFor();
  }
  assert.equal(await page.getByTestId('record-toggle').isDisabled(), true);
  noProblems(problems, REFUSED);
});

test("another site's page can neither read nor command, nor show the page in a frame", async (t) => {
  const daemon = await Daemon.start(t, SIM);
  const api = new Api(daemon.url);
  await until('idle', async () => (await api.device('inside')).state === 'idle');
  const foreign = createServer((_, response) => response.writeHead(200, { 'content-type': 'text/html' }).end('<!doctype html><title>other</title><body>'));
  await new Promise((done) => foreign.listen(0, '127.0.0.1', done));
  t.after(() => foreign.close());
  const chromium = await browser(t);
  // Another port of the same machine is same-site; another name is another site.
  for (const host of ['127.0.0.1', 'localhost']) {
    const { page, context } = await open(chromium, `http://${host}:${foreign.address().port}/`);
    const got = await page.evaluate(async (url) => {
      const outcome = async (what) => {
        try {
          return await what();
        } catch (error) {
          return error.name;
        }
      };
      const json = { 'content-type': 'application/json', 'ihd-holder': 'mallory' };
      const command = `${url}/api/v1/devices/inside/commands`;
      const body = '{"command":"power","power_w":900}';
      return {
        read: await outcome(async () => (await fetch(`${url}/api/v1/devices`)).text()),
        opaque: await outcome(async () => (await fetch(`${url}/api/v1/devices`, { mode: 'no-cors' })).text()),
        command: await outcome(async () => (await fetch(command, { method: 'POST', headers: json, body })).status),
        plain: await outcome(async () => (await fetch(command, { method: 'POST', mode: 'no-cors', body })).status),
        events: await new Promise((done) => {
          const source = new EventSource(`${url}/api/v1/live`);
          source.addEventListener('telemetry', () => done('heard'));
          source.addEventListener('error', () => done('refused'));
        }),
        frame: await new Promise((done) => {
          const frame = document.createElement('iframe');
          frame.src = url;
          frame.onload = () => {
            try {
              done(frame.contentDocument ? 'own' : 'blocked');
            } catch {
              done('blocked');
            }
          };
          document.body.append(frame);
        }),
      };
    }, daemon.url);
    // Without CORS a page gets an answer that it cannot read, or none.
    const nothing = (x) => (['', 0, 'TypeError'].includes(x) ? 'nothing' : x);
    const told = { ...got, opaque: nothing(got.opaque), plain: nothing(got.plain) };
    assert.deepEqual(told, { read: 'TypeError', opaque: 'nothing', command: 'TypeError', plain: 'nothing', events: 'refused', frame: 'blocked' }, host);
    const inside = page.frames().find((frame) => frame !== page.mainFrame());
    assert.equal(await inside?.locator('#header').count().catch(() => 0) ?? 0, 0, 'the page in a frame');
    await context.close();
  }
  const { live, asked_by_daemon_w } = await api.device('inside');
  assert.deepEqual([live.asked_w, asked_by_daemon_w], [0, 0], 'nobody heated');
});

test('the page is served without a token, and tells nothing', async (t) => {
  const { daemon } = await withTokens(t);
  const front = await fetch(daemon.url);
  assert.equal(front.status, 200);
  assert.match(front.headers.get('content-security-policy'), /default-src 'none'.*frame-ancestors 'none'/);
  assert.equal(front.headers.get('x-content-type-options'), 'nosniff');
  assert.doesNotMatch(await front.text(), /inside/);
  assert.equal((await fetch(`${daemon.url}/api/v1/devices`)).status, 401);
  for (const path of ['/page/../Cargo.toml', '/page/%2e%2e/Cargo.toml', '/page/js/..%2f..%2f..%2fCargo.toml']) {
    assert.notEqual((await fetch(daemon.url + path)).status, 200, path);
  }
});
