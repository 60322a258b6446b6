// Requests to the server of this page, and what comes back of them.

/**
 * @typedef {{title: string, detail: string, expected?: string, got?: string, remedy?: string, type?: string}} Problem
 */

/** An error that the server reports. */
export class ApiProblem extends Error {
  /**
   * @param {number} status
   * @param {Problem} problem
   * @param {number} retryS  When to ask again, s; 0 where that does not help.
   */
  constructor(status, problem, retryS) {
    super(problem.detail);
    this.status = status;
    this.problem = problem;
    this.retryS = retryS;
  }
}

/** The server does not answer at all. */
export class ApiAway extends Error {}

// Of this visit alone: kept in no storage and in no address.
let key = "";

/** @param {string} text */
export function useKey(text) {
  key = text.trim();
}

/** Whether a key was entered. */
export function hasKey() {
  return key !== "";
}

/**
 * A page's JSON.
 * @param {string} path  Relative to the page.
 * @param {object} [body]  Sent as JSON; a GET without one.
 * @returns {Promise<any>}
 */
export async function ask(path, body) {
  /** @type {Record<string, string>} */
  const headers = key ? { Authorization: `Bearer ${key}` } : {};
  if (body) headers["Content-Type"] = "application/json";
  let answer;
  try {
    answer = await fetch(path, {
      method: body ? "POST" : "GET",
      headers,
      body: body ? JSON.stringify(body) : undefined,
      cache: "no-store",
      credentials: "omit",
    });
    if (answer.ok) return await answer.json();
  } catch {
    throw new ApiAway("the server does not answer");
  }
  throw new ApiProblem(answer.status, await problemOf(answer), retryAfter(answer));
}

/**
 * @param {Response} answer
 * @returns {Promise<Problem>}
 */
async function problemOf(answer) {
  try {
    const body = await answer.json();
    if (typeof body.title === "string") return body;
  } catch {
    // Something between here and the server answered.
  }
  return { title: `The server answers with ${answer.status}`, detail: answer.statusText || "without a reason" };
}

/** @param {Response} answer */
function retryAfter(answer) {
  if (![408, 429, 503].includes(answer.status)) return 0;
  return Math.min(30, Number(answer.headers.get("Retry-After")) || 2);
}
