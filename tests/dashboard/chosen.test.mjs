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
  const power = page.getByTestId('power-input');
  const asked = async () => (await own.do('truth', { device: 'bench' })).asked_w;
  const commands = async () => (await (await fetch(`${own.url}/api/v1/journal?device=bench&kind=command&limit=50`)).json()).map(({ text }) => text);
  // On a machine that stalls for seconds the page gives its lease back, and shows its first power again, maybe before the click.
  const heat = (watt) => until('it heats', async () => {
    if ((await commands())[0] === `power: ${watt} W asked for`) return true;
    await power.fill(String(watt));
    await page.getByTestId('power-set').click();
  }, 500);
  await heat(950);
  await page.goto(address(own.url, 'events'));
  const search = page.getByRole('searchbox');
  await search.fill('pot');
  await search.press('Escape');
  assert.equal(await search.inputValue(), '');
  await page.goto(address(own.url, 'live', 'bench'));
  await until('its power is shown', async () => (await power.inputValue()) === '950' || (await asked()) === 0);
  await page.getByTestId('sweep').click();
  await page.keyboard.press('Escape');
  await page.getByRole('dialog').waitFor({ state: 'detached' });
  // The next command of the page is the first Off.
  await heat(1000);
  await page.keyboard.press('Escape');
  await until('it is off', async () => (await commands())[0] === 'off: off' && (await asked()) === 0);
  const told = await commands();
  const begun = told.lastIndexOf('power: 950 W asked for');
  assert.deepEqual(told.slice(0, begun).filter((text) => text.startsWith('off')), ['off: off']);
  noProblems(problems);
});
