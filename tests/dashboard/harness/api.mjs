// The daemon's API, asked beside the page: what a page shows is compared with what the daemon says.

/** Answers of one daemon. */
export class Api {
  constructor(url, headers = {}) {
    this.base = `${url}/api/v1`;
    this.headers = headers;
  }

  async ask(path, options = {}) {
    // A connection of its own: a kept one may be closed by the daemon, as idle, while a slow test sends.
    const headers = { connection: 'close', 'ihd-holder': 'the test', ...this.headers, ...options.headers };
    const answer = await fetch(`${this.base}${path}`, { ...options, headers });
    const text = await answer.text();
    return { status: answer.status, body: text && answer.headers.get('content-type')?.includes('json') ? JSON.parse(text) : text };
  }

  /** The body of a GET that must succeed. */
  async get(path) {
    const { status, body } = await this.ask(path);
    if (status !== 200) throw new Error(`GET ${path}: ${status} ${JSON.stringify(body)}`);
    return body;
  }

  device(name) {
    return this.get(`/devices/${name}`);
  }

  command(name, body) {
    const headers = { 'content-type': 'application/json' };
    return this.ask(`/devices/${name}/commands`, { method: 'POST', headers, body: JSON.stringify(body) });
  }
}
