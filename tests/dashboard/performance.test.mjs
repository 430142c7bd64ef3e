// What an open page costs: 4 devices at 50 Hz with an hour of history, the live view before one's eyes; and whether it
// costs more with time.

import assert from 'node:assert/strict';
import { test as always } from 'node:test';

import { Bare } from './harness/bare.mjs';
import { browser, noProblems, open } from './harness/browser.mjs';
import { Fake, sleep } from './harness/processes.mjs';

const FULL = process.env.IHD_DASHBOARD_FULL === '1';
/** What is measured is measured alone: in the full tier. */
const test = FULL ? always : always.skip;
/** Of issue 18. */
const SCRIPT_PERCENT = 5;
const HEAP_MB = 150;
/** Growth of the heap after garbage collection that is none: noise of the measurement, over half an hour. */
const LEAK_MB_PER_H = 8;
/** Of a table that is scrolled. */
const FRAMES = 200;
const MEASURED_S = 60;
const SOAK_S = Number(process.env.IHD_SOAK_S ?? 1800);

/** The live view with an hour of history, and what the debugger knows of it. */
async function watch(t, ...options) {
  const fake = await Fake.start(t, '--devices', '4', '--rate', '50', '--history', '3600', '--heating', ...options);
  const chromium = await browser(t);
  const { page, context, problems } = await open(chromium, `${fake.url}/#/live/desk`, { viewport: { width: 1600, height: 1000 } });
  await page.getByRole('button', { name: '1 h', exact: true }).first().click();
  const cdp = await context.newCDPSession(page);
  // Processor time of the page's thread, not of the clock on the wall: other processes have the machine too.
  await cdp.send('Performance.enable', { timeDomain: 'threadTicks' });
  return { fake, page, problems, meter: new Meter(cdp, await chromium.newBrowserCDPSession()) };
}

class Meter {
  constructor(page, browser) {
    this.page = page;
    this.browser = browser;
  }

  async metrics() {
    const { metrics } = await this.page.send('Performance.getMetrics');
    return Object.fromEntries(metrics.map(({ name, value }) => [name, value]));
  }

  /** Heap in MB with nothing in it that nobody holds. */
  async heapMb() {
    await this.page.send('HeapProfiler.collectGarbage');
    return (await this.metrics()).JSHeapUsedSize / 1e6;
  }

  /** Processor seconds of the process that shows the page: the one that has taken most. */
  async cpuS() {
    const { processInfo } = await this.browser.send('SystemInfo.getProcessInfo');
    return Math.max(...processInfo.filter(({ type }) => type === 'renderer').map(({ cpuTime }) => cpuTime));
  }

  /** Over so many seconds: shares of a core in percent, and the heap. */
  async over(seconds) {
    const [before, cpuBefore, begun] = [await this.metrics(), await this.cpuS(), Date.now()];
    let most = 0;
    for (let k = 0; k < seconds; k++) {
      await sleep(1000);
      most = Math.max(most, (await this.metrics()).JSHeapUsedSize / 1e6);
    }
    const [after, cpuAfter] = [await this.metrics(), await this.cpuS()];
    const wall = (Date.now() - begun) / 1000;
    const share = (name) => (100 * (after[name] - before[name])) / wall;
    return {
      script: share('ScriptDuration'),
      task: share('TaskDuration'),
      process: (100 * (cpuAfter - cpuBefore)) / wall,
      heapMostMb: most,
      heapMb: await this.heapMb(),
      nodes: after.Nodes,
      listeners: after.JSEventListeners,
    };
  }
}

const words = (m) =>
  `script ${m.script.toFixed(2)} % of a core, all tasks ${m.task.toFixed(1)} %, process ${m.process.toFixed(1)} %; heap ${m.heapMb.toFixed(1)} MB ` +
  `(at most ${m.heapMostMb.toFixed(1)}); ${m.nodes} nodes, ${m.listeners} listeners`;

test('an open live view takes at most 5 % of a core and 150 MB', async (t) => {
  const { fake, meter, problems, page } = await watch(t);
  const bare = await Bare.start(t, `${fake.url}/#/live/desk`);
  await sleep(8000);
  const found = await meter.over(MEASURED_S);
  const mb = await bare.rendererMb();
  t.diagnostic(`events every 200 ms, ${MEASURED_S} s: ${words(found)}; the process of a page without a debugger ${mb.toFixed(0)} MB`);
  assert.ok(found.script <= SCRIPT_PERCENT, `script ${found.script} %`);
  // Less than this and it draws nothing.
  assert.ok(found.script >= 0.02, `script ${found.script} %: does it draw?`);
  assert.ok(found.heapMostMb <= HEAP_MB, words(found));
  assert.ok(mb > 20 && mb <= HEAP_MB, `${mb} MB`);
  assert.equal(await page.getByTestId('stale').isVisible(), false);
  noProblems(problems);
});

test('events at 50 Hz, ten times what the page asks for', async (t) => {
  const { meter, problems, page } = await watch(t, '--events', '20');
  await sleep(6000);
  const found = await meter.over(30);
  t.diagnostic(`events every 20 ms: ${words(found)}`);
  assert.ok(found.script <= SCRIPT_PERCENT, `script ${found.script} %`);
  assert.equal(await page.getByTestId('stale').isVisible(), false);
  noProblems(problems);
});

test('going round through the views leaves nothing behind', async (t) => {
  const { fake, meter, page, problems } = await watch(t);
  const round = async () => {
    for (const view of ['devices', 'live/bench', 'map/desk', 'training/desk', 'events', 'fleet', 'recordings/desk', 'live/desk']) {
      await page.goto(`${fake.url}/#/${view}`);
      await page.locator(`main .view-${view.split('/')[0]}`).waitFor();
      await sleep(250);
    }
  };
  for (let k = 0; k < 2; k++) await round();
  const [first, before] = [await meter.heapMb(), await meter.metrics()];
  const rounds = 40;
  for (let k = 0; k < rounds; k++) await round();
  const [last, after] = [await meter.heapMb(), await meter.metrics()];
  const listeners = after.JSEventListeners - before.JSEventListeners;
  t.diagnostic(`${rounds} rounds: heap ${first.toFixed(1)} to ${last.toFixed(1)} MB, ${before.Nodes} to ${after.Nodes} nodes, ${listeners} more listeners`);
  // A view that stays has hundreds of nodes; a stretch of history is some 100 kB.
  assert.ok(last - first < 0.3 * rounds + 2, `the heap grew by ${(last - first).toFixed(1)} MB in ${rounds} rounds`);
  assert.ok(after.Nodes - before.Nodes < 60 * rounds + 500, `${after.Nodes - before.Nodes} more nodes after ${rounds} rounds`);
  noProblems(problems);
});

test('a fleet of a thousand devices, looked at and scrolled', async (t) => {
  const { fake, meter, page, problems } = await watch(t, '--fleet', '1000');
  await page.goto(`${fake.url}/#/fleet`);
  await page.getByTestId('fleet-count').waitFor();
  await sleep(2000);
  const found = await meter.over(20);
  const before = await meter.metrics();
  await page.getByTestId('fleet-devices').evaluate(scrolled, FRAMES);
  const perFrame = (1000 * ((await meter.metrics()).TaskDuration - before.TaskDuration)) / FRAMES;
  t.diagnostic(`the fleet's page, 1000 devices: ${words(found)}; scrolled by 300 px a frame: ${perFrame.toFixed(1)} ms of a core a frame`);
  assert.ok(found.script <= SCRIPT_PERCENT, `script ${found.script} %`);
  assert.ok(found.heapMostMb <= HEAP_MB, words(found));
  noProblems(problems);
});

/** In the page: an element is scrolled, so many frames long. */
async function scrolled(box, frames) {
  for (let k = 0; k < frames; k++) {
    box.scrollTop = (box.scrollTop + 300) % (box.scrollHeight - box.clientHeight);
    await new Promise(requestAnimationFrame);
  }
}

test('for half an hour: no leak', { skip: SOAK_S ? false : 'in the full form (--full, or IHD_SOAK_S)' }, async (t) => {
  const { fake, meter, page, problems } = await watch(t);
  const bare = await Bare.start(t, `${fake.url}/#/live/desk`);
  await sleep(30000);
  const points = [];
  const begun = Date.now();
  const before = await meter.metrics();
  while (Date.now() - begun < SOAK_S * 1000) {
    await sleep(Math.min(20000, SOAK_S * 50));
    points.push([(Date.now() - begun) / 3.6e6, await meter.heapMb()]);
    if (points.length % 15 === 0) t.diagnostic(`${Math.round(points.at(-1)[0] * 60)} min: ${points.at(-1)[1].toFixed(1)} MB`);
  }
  const after = await meter.metrics();
  const mb = await bare.rendererMb();
  const slope = leastSquares(points);
  const script = (100 * (after.ScriptDuration - before.ScriptDuration)) / ((Date.now() - begun) / 1000);
  t.diagnostic(
    `${SOAK_S} s: heap ${points[0][1].toFixed(1)} to ${points.at(-1)[1].toFixed(1)} MB, slope ${slope.toFixed(2)} MB/h; script ${script.toFixed(2)} % of a core; ` +
      `process without a debugger ${mb.toFixed(0)} MB; nodes ${before.Nodes} to ${after.Nodes}, listeners ${before.JSEventListeners} to ${after.JSEventListeners}`,
  );
  assert.ok(slope < LEAK_MB_PER_H, `the heap grows by ${slope.toFixed(2)} MB/h`);
  assert.ok(script <= SCRIPT_PERCENT, `script ${script} %`);
  assert.ok(mb > 20 && mb <= HEAP_MB, `${mb} MB`);
  assert.equal(await page.getByTestId('stale').isVisible(), false);
  noProblems(problems);
});

function leastSquares(points) {
  const mean = (k) => points.reduce((sum, p) => sum + p[k], 0) / points.length;
  const [x, y] = [mean(0), mean(1)];
  const [xy, xx] = points.reduce(([a, b], p) => [a + (p[0] - x) * (p[1] - y), b + (p[0] - x) ** 2], [0, 0]);
  return xy / xx;
}
