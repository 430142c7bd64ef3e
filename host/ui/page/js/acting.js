// @ts-check
/** Commands of a view that change something: asked before, taken over only when a person says so, and told after. */

/** @typedef {import("./context.js").Context} Context */

/**
 * Why this page may not command; empty where it may.
 * @param {Context} context
 */
export function mayNot(context) {
  return context.session.role === "read" ? "This token may look, not command (role read); log in with an operate token." : "";
}

/**
 * Carries out a command that needs the lease. Where somebody else commands the device, a person is asked whether to take over.
 * @param {Context} context
 * @param {string} device
 * @param {{command: string, [field: string]: any}} body
 * @param {string} doing what is done, as in `roll back`
 * @returns {Promise<{text: string, file: string | null} | null>} null where it was not done; why was told
 */
export async function act(context, device, body, doing) {
  try {
    return told(context, await context.leases.act(device, body));
  } catch (why) {
    const problem = /** @type {any} */ (why);
    if (problem?.status !== 423) {
      context.complain(`${device}: could not ${doing}`, why);
      return null;
    }
    if (!(await takeOver(context, device, problem.problem?.holder ?? "Somebody", doing))) return null;
  }
  try {
    return told(context, await context.leases.act(device, body, true));
  } catch (why) {
    context.complain(`${device}: could not ${doing}`, why);
    return null;
  }
}

/** @param {Context} context @param {{text: string, file: string | null}} done */
function told(context, done) {
  context.announce(done.text);
  return done;
}

/** @param {Context} context @param {string} device @param {string} holder @param {string} doing */
async function takeOver(context, device, holder, doing) {
  const answer = await context.ask({
    title: `${holder} commands ${device}`,
    text: `To ${doing}, this page has to take over. That switches the hob off first, whatever it heats, and ${holder} is told.`,
    answers: [{ label: `Take over and ${doing}`, value: "take", danger: true }],
  });
  return answer === "take";
}
