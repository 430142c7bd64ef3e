// Who may do what: Host header, other sites' pages, tokens and the cookie of a session.

import { Refusal } from './daemon.mjs';

const ROLES = ['read', 'operate'];

/** Turns away requests to another name, and those of other sites' pages. */
export function guard(request) {
  const host = request.headers.host ?? '';
  if (!['127.0.0.1', 'localhost', '[::1]'].includes(host.replace(/:\d+$/, ''))) {
    throw new Refusal(421, 'host', 'this machine does not go by that name: call it by its address, or add the name to `allowed_hosts`');
  }
  const site = request.headers['sec-fetch-site'];
  const foreign = ['cross-site', 'same-site'].includes(site) && request.headers['sec-fetch-mode'] !== 'navigate';
  const origin = request.headers.origin;
  if (foreign || (request.method !== 'GET' && origin && origin !== `http://${host}`)) {
    throw new Refusal(403, 'cross-site', "another site's page may not ask this");
  }
}

/** Tokens by role; without one everybody operates. */
export class Tokens {
  constructor(tokens) {
    this.roles = new Map(Object.entries(tokens).filter(([, token]) => token).map(([role, token]) => [token, role]));
  }

  get needed() {
    return this.roles.size > 0;
  }

  role(request) {
    if (!this.needed) return 'operate';
    const bearer = /^bearer (.*)$/i.exec(request.headers.authorization ?? '')?.[1];
    const cookie = /(?:^|; )ihd-session=([^;]*)/.exec(request.headers.cookie ?? '')?.[1];
    const role = this.roles.get(bearer ?? cookie ?? '');
    if (!role) throw new Refusal(401, 'token', bearer || cookie ? 'this token is not known here' : 'a token is needed: send `Authorization: Bearer TOKEN`');
    return role;
  }

  allow(request, wanted) {
    if (ROLES.indexOf(this.role(request)) < ROLES.indexOf(wanted)) throw new Refusal(403, 'role', `this needs the role ${wanted}`);
  }

  /** The headers of a session that begins. */
  begin(token) {
    if (!this.roles.has(token)) throw new Refusal(401, 'token', 'this token is not known here');
    return { 'set-cookie': `ihd-session=${token}; HttpOnly; SameSite=Strict; Path=/` };
  }

  static end() {
    return { 'set-cookie': 'ihd-session=; HttpOnly; SameSite=Strict; Path=/; Max-Age=0' };
  }
}
