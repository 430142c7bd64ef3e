// The device that is chosen, and what the page heats: neither changes unless a person changes it.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { browser, noProblems, open } from './harness/browser.mjs';
import { Fake, until } from './harness/processes.mjs';

const address = (url, view, device) => `${url}/#/${view}${device ? `/${device}` : ''}`;

test('the device that the hash names stays chosen where the daemon does not know it', async (t) => {
  const own = await Fake.start(t);
  const { page, problems } = await open(await browser(t), address(own.url, 'live', 'nosuch'));
  const unknown = (name) => page.getByText(`${name} is not known to the daemon`).waitFor();
  await unknown('nosuch');
  assert.equal(await page.getByTestId('power-set').count(), 0);
  await page.goto(address(own.url, 'live', 'desk'));
  await page.getByTestId('power-set').waitFor();
  await own.do('gone', { device: 'desk' });
  await unknown('desk');
  assert.deepEqual([await page.getByTestId('power-set').count(), await page.getByTestId('device-chooser').inputValue()], [0, 'desk']);
  await own.do('gone', { device: null });
  await page.getByTestId('power-set').waitFor();
  assert.equal(await page.getByRole('heading', { name: 'Live: desk' }).count(), 1);
  // A window may have been asked for of the device that went.
  noProblems(problems, /status of 404/);
});

test('a page that heats shows its power again, and Escape in a search or a question is no Off', async (t) => {
  const own = await Fake.start(t);
  const { page, problems } = await open(await browser(t), address(own.url, 'live', 'bench'));
  const asked = async () => (await own.do('truth', { device: 'bench' })).asked_w;
  await page.getByTestId('power-input').fill('950');
  await page.getByTestId('power-set').click();
  await until('it heats', async () => (await asked()) === 950);
  await page.goto(address(own.url, 'events'));
  const search = page.getByRole('searchbox');
  await search.fill('pot');
  await search.press('Escape');
  assert.equal(await search.inputValue(), '');
  await page.goto(address(own.url, 'live', 'bench'));
  assert.equal(await page.getByTestId('power-input').inputValue(), '950');
  await page.getByTestId('sweep').click();
  await page.keyboard.press('Escape');
  await page.getByRole('dialog').waitFor({ state: 'detached' });
  // The next command of the page is the first Off.
  await page.getByTestId('power-input').fill('1000');
  await page.getByTestId('power-set').click();
  await until('it heats on', async () => (await asked()) === 1000);
  await page.keyboard.press('Escape');
  await until('it is off', async () => (await asked()) === 0);
  const commands = await (await fetch(`${own.url}/api/v1/journal?device=bench&kind=command&limit=3`)).json();
  assert.deepEqual(commands.map(({ text }) => text), ['off: off', 'power: 1000 W asked for', 'power: 950 W asked for']);
  noProblems(problems);
});
