// A daemon that is none: serves host/ui/page and every route of the API with seeded data, for work on the page and for
// measuring it. Plain Node, no dependencies.
//
//     node tests/dashboard/fake/main.mjs --port 8799 --devices 4
//
// SIGUSR1 kills it (every socket closed, nobody listens), SIGUSR2 brings it back. `POST /fake/…` does the same and more:
//     curl -d '{"device":"bench","pot":"none"}' localhost:8799/fake/pot     # also ferritic-21, cast-iron-21, …
//     curl -d '{"device":"bench","fault":24}' localhost:8799/fake/fault
//     curl -d '{"device":"bench","connected":false}' localhost:8799/fake/connected
//     curl -d '{"device":"bench"}' localhost:8799/fake/gone                 # no device of the daemon any more; null: all are back
//     curl -d '{"device":"bench","power_w":1200}' localhost:8799/fake/power  # as at its panel
//     curl -d '{"for_s":5}' localhost:8799/fake/die                          # and back after so many seconds
//     curl -d '{"for_s":5}' localhost:8799/fake/silence                      # connected, and says nothing
//     curl -d '{"ms":800}' localhost:8799/fake/slow                          # every answer takes so long
//     curl -d '{"ms":20}' localhost:8799/fake/events                         # an event this often, whatever was asked for
//     curl -d '{}' localhost:8799/fake/watchers                             # streams that are open
//     curl -d '{"device":"bench"}' localhost:8799/fake/truth
//     curl -d '{"connected":false,"why":"no answer"}' localhost:8799/fake/fleet   # also devices: N, 0 is no edge of a fleet

import { readFile } from 'node:fs/promises';
import { createServer } from 'node:http';
import { extname, join, normalize } from 'node:path';
import { fileURLToPath } from 'node:url';
import { parseArgs } from 'node:util';

import { Tokens, guard } from './access.mjs';
import { Daemon, Refusal } from './daemon.mjs';
import { api, json, mend } from './routes.mjs';

const { values } = parseArgs({
  options: {
    port: { type: 'string', default: '8799' },
    devices: { type: 'string', default: '4' },
    fleet: { type: 'string', default: '60' }, // hobs of the fleet that it is an edge of; 0: it is none
    rate: { type: 'string', default: '100' }, // half-cycles a second
    history: { type: 'string', default: '3600' }, // seconds of past
    heating: { type: 'boolean', default: false }, // all hobs heat from the beginning
    token: { type: 'string' }, // of the role operate
    'read-token': { type: 'string' },
    slow: { type: 'string', default: '0' }, // milliseconds that every answer takes
    events: { type: 'string', default: '0' }, // milliseconds from event to event, whatever was asked for
    seed: { type: 'string', default: '1' },
    page: { type: 'string', default: fileURLToPath(new URL('../../../host/ui/page', import.meta.url)) },
  },
});
const port = Number(values.port);
const options = { slowMs: Number(values.slow), eventMs: Number(values.events), silentUntilMs: 0 };
const daemon = new Daemon({
  devices: Number(values.devices),
  fleet: Number(values.fleet),
  rate: Number(values.rate),
  historyS: Number(values.history),
  heating: values.heating,
  seed: Number(values.seed),
});
const tokens = new Tokens({ operate: values.token, read: values['read-token'] });

const TYPES = { '.html': 'text/html; charset=utf-8', '.js': 'text/javascript', '.css': 'text/css', '.json': 'application/json', '.svg': 'image/svg+xml', '.png': 'image/png' };
const PAGE_HEADERS = {
  'content-security-policy':
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data: blob:; worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
  'x-content-type-options': 'nosniff',
  'referrer-policy': 'no-referrer',
  'cache-control': 'no-cache',
};

async function page(response, path) {
  const file = normalize(join(values.page, path));
  if (!file.startsWith(values.page)) throw new Refusal(404, 'no-route', 'there is nothing here');
  const bytes = await readFile(file).catch(() => {
    throw new Refusal(404, 'no-route', `there is no ${path} in ${values.page}`);
  });
  response.writeHead(200, { ...PAGE_HEADERS, 'content-type': TYPES[extname(file)] ?? 'application/octet-stream' });
  response.end(bytes);
}

async function bodyOf(request) {
  let text = '';
  for await (const chunk of request) text += chunk;
  try {
    return text ? JSON.parse(text) : {};
  } catch {
    throw new Refusal(400, 'body', 'not JSON');
  }
}

async function answer(request, response) {
  guard(request);
  const url = new URL(request.url, `http://127.0.0.1:${port}`);
  const parts = url.pathname.split('/').filter(Boolean).map(decodeURIComponent);
  if (url.pathname === '/') return page(response, 'index.html');
  if (parts[0] === 'page') return page(response, parts.slice(1).join('/'));
  if (url.pathname === '/healthz') {
    const failure = options.storeFailure ?? null;
    return json(response, failure ? 503 : 200, { service: 'ihd', store: !failure, store_failure: failure });
  }
  const body = await bodyOf(request);
  if (parts[0] === 'fake') return fake(response, parts[1], body);
  if (options.slowMs) await new Promise((done) => setTimeout(done, options.slowMs));
  return api(daemon, tokens, options, request, response, parts.slice(2), url.searchParams, body);
}

function fake(response, what, body) {
  if (what !== 'die') return json(response, 200, mend(daemon, options, what, body));
  json(response, 200, { for_s: body.for_s ?? 5 });
  setTimeout(die, 50);
  return setTimeout(live, 50 + 1000 * (body.for_s ?? 5));
}

const server = createServer((request, response) => {
  answer(request, response).catch((error) => {
    if (!(error instanceof Refusal)) console.error(error);
    const { status = 500, error: word = 'failed', message, fields = {} } = error;
    if (response.headersSent) response.destroy();
    else json(response, status, { error: word, message, ...fields });
  });
});

let deadSinceMs = null;
function die() {
  if (deadSinceMs) return;
  deadSinceMs = Date.now();
  daemon.down = true;
  server.close();
  server.closeAllConnections();
}
function live() {
  if (!deadSinceMs) return;
  daemon.silent.push([deadSinceMs, Date.now()]);
  deadSinceMs = null;
  daemon.down = false;
  server.listen(port, '127.0.0.1');
}
process.on('SIGUSR1', die);
process.on('SIGUSR2', live);
server.listen(port, '127.0.0.1', () => console.log(`the fake daemon listens url=http://127.0.0.1:${port} devices=${values.devices}`));
