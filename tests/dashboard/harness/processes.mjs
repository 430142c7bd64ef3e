// `ihd` and the fake daemon as processes that do not outlive their test.

import { spawn } from 'node:child_process';
import { mkdtemp, rm, writeFile } from 'node:fs/promises';
import { createServer } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { fileURLToPath } from 'node:url';

/** The command under test: `cargo xtask test --only dashboard` names it. */
const IHD = process.env.IHD_BIN;

/** Ends what hangs; no test is judged by it. */
export const PATIENCE_MS = 240000;

/** Waits until `look` gives something else than null, false and undefined; an error that says what was waited for. */
export async function until(what, look, everyMs = 100, withinMs = PATIENCE_MS) {
  const deadline = Date.now() + withinMs;
  let last;
  for (;;) {
    try {
      const found = await look();
      if (found) return found;
      last = undefined;
    } catch (error) {
      last = error;
    }
    if (Date.now() > deadline) {
      throw new Error(`waited ${withinMs} ms in vain for: ${what}${last ? ` (${last.message})` : ''}`);
    }
    await sleep(everyMs);
  }
}

export const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

/** A port of loopback that nobody listens on. */
export async function freePort() {
  const server = createServer();
  await new Promise((done) => server.listen(0, '127.0.0.1', done));
  const { port } = server.address();
  await new Promise((done) => server.close(done));
  return port;
}

/** A process whose output is kept; killed at the test's end. */
class Running {
  constructor(t, program, words, options = {}) {
    this.child = spawn(program, words, { stdio: ['pipe', 'pipe', 'pipe'], ...options });
    this.said = '';
    this.child.stdin.on('error', () => {});
    for (const stream of [this.child.stdout, this.child.stderr]) {
      stream.setEncoding('utf8');
      stream.on('data', (text) => (this.said = (this.said + text).slice(-200000)));
    }
    this.ended = new Promise((done) => {
      this.child.on('error', (error) => done(error.message));
      this.child.on('exit', (code, signal) => done(signal ?? code));
    });
    t.after(() => this.kill());
  }

  /** What it says, once it does: the match of a pattern. */
  says(pattern) {
    const look = () => pattern.exec(this.said);
    return until(`${pattern} from ${this.child.spawnargs.join(' ')}`, look, 20).catch((error) => {
      throw new Error(`${error.message}; it said:\n${this.said}`);
    });
  }

  async kill() {
    this.child.kill('SIGKILL');
    await this.ended;
  }
}

/** A simulated hob behind a TCP port, which takes events on its standard input. */
export class Hob extends Running {
  static async start(t, ...options) {
    const hob = new Hob(t, IHD, ['hob', '--listen', '127.0.0.1:0', '--script', '-', ...options]);
    [, hob.address] = await hob.says(/on tcp:(127\.0\.0\.1:\d+)/);
    return hob;
  }

  /** What happens to it: `pot = "none"`. */
  event(line) {
    this.child.stdin.write(`${line}\n`);
  }
}

/** The daemon of a folder of its own; started, killed and started again. */
export class Daemon {
  static async start(t, devices, { head = '' } = {}) {
    const daemon = new Daemon();
    daemon.folder = await mkdtemp(join(tmpdir(), 'ihd-dashboard-'));
    // The process first: it writes into its folder as long as it lives, and a failed hook would leave it running.
    t.after(async () => {
      await daemon.process?.kill();
      await rm(daemon.folder, { recursive: true, force: true });
    });
    daemon.port = await freePort();
    daemon.url = `http://127.0.0.1:${daemon.port}`;
    const file = `store = "store"\nlisten = "127.0.0.1:${daemon.port}"\n${head}\n${devices}`;
    await writeFile(join(daemon.folder, 'ihd.toml'), file);
    await daemon.run(t);
    return daemon;
  }

  async run(t) {
    this.process = new Running(t, IHD, ['trainer', '--daemon'], { cwd: this.folder });
    await this.process.says(/the daemon listens/);
  }

  kill() {
    return this.process.kill();
  }
}

/** The fake daemon. */
export class Fake {
  static async start(t, ...options) {
    const fake = new Fake();
    fake.port = await freePort();
    fake.url = `http://127.0.0.1:${fake.port}`;
    const main = fileURLToPath(new URL('../fake/main.mjs', import.meta.url));
    fake.process = new Running(t, process.execPath, [main, '--port', String(fake.port), ...options]);
    await fake.process.says(/the fake daemon listens/);
    return fake;
  }

  /** `POST /fake/…`. */
  async do(what, body = {}) {
    const answer = await fetch(`${this.url}/fake/${what}`, { method: 'POST', body: JSON.stringify(body) });
    return answer.json();
  }
}

/** A slow network between browser and daemon (harness/link.py). */
export class Link extends Running {
  static async start(t, port) {
    const script = fileURLToPath(new URL('link.py', import.meta.url));
    const link = new Link(t, 'python3', [script, String(port)]);
    link.url = `http://127.0.0.1:${(await link.says(/the link listens port=(\d+)/))[1]}`;
    return link;
  }

  /** So many bytes a second from the daemon from now on; 0 for no limit. */
  limit(bytesPerS) {
    this.child.stdin.write(`${bytesPerS}\n`);
  }
}
