// A browser that nobody looks into: a debugger's buffers would be counted as the page's memory.

import { spawn } from 'node:child_process';
import { mkdtemp, readFile, readdir, rm } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

/** Chromium with one page, and the memory of the process that shows it. */
export class Bare {
  static async start(t, url) {
    const bare = new Bare();
    bare.profile = await mkdtemp(join(tmpdir(), 'ihd-bare-'));
    const words = ['--headless', '--no-sandbox', '--remote-debugging-port=0', `--user-data-dir=${bare.profile}`, '--window-size=1600,1000', url];
    bare.child = spawn(process.env.IHD_CHROMIUM ?? '/usr/bin/chromium', words, { stdio: 'ignore', detached: true });
    t.after(async () => {
      // Its own group alone: the browser and what it started.
      process.kill(-bare.child.pid, 'SIGKILL');
      await new Promise((done) => setTimeout(done, 300));
      await rm(bare.profile, { recursive: true, force: true });
    });
    return bare;
  }

  /** Private memory of the largest renderer, in MB. */
  async rendererMb() {
    let most = 0;
    for (const pid of await readdir('/proc')) {
      const words = /^\d+$/.test(pid) ? await readFile(`/proc/${pid}/cmdline`, 'latin1').catch(() => '') : '';
      if (!words.includes('--type=renderer') || (await groupOf(pid)) !== this.child.pid) continue;
      const status = await readFile(`/proc/${pid}/status`, 'utf8').catch(() => '');
      most = Math.max(most, Number(/RssAnon:\s+(\d+)/.exec(status)?.[1] ?? 0) / 1024);
    }
    return most;
  }
}

/** The process group of a process: the third number after its name. */
async function groupOf(pid) {
  const stat = await readFile(`/proc/${pid}/stat`, 'utf8').catch(() => ') ? 0 0');
  return Number(stat.slice(stat.lastIndexOf(')') + 2).split(' ')[2]);
}
