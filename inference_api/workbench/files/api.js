// Requests to the server of this page.

/** @typedef {{title: string, detail: string}} Problem */

/** An error that the server reports. */
export class ApiProblem extends Error {
  /** @param {number} status @param {Problem} problem @param {number} retryS  0 where another request does not help. */
  constructor(status, problem, retryS) {
    super(problem.detail);
    this.status = status;
    this.problem = problem;
    this.retryS = retryS;
  }
}

/** The server does not answer at all. */
export class ApiAway extends Error {}

// Kept in memory only, in no storage and in no address.
let key = "";

/** @param {string} text */
export function useKey(text) {
  key = text.trim();
}

export const hasKey = () => key !== "";

/**
 * The JSON of an endpoint: POST with a body, GET without.
 * @param {string} path  Relative to the page.
 * @param {object} [body]
 * @returns {Promise<any>}
 */
export async function ask(path, body) {
  /** @type {Record<string, string>} */
  const headers = key ? { Authorization: `Bearer ${key}` } : {};
  if (body) headers["Content-Type"] = "application/json";
  const method = body ? "POST" : "GET";
  let answer;
  try {
    answer = await fetch(path, { method, headers, body: body && JSON.stringify(body), cache: "no-store", credentials: "omit" });
    if (answer.ok) return await answer.json();
  } catch {
    throw new ApiAway("the server does not answer");
  }
  const retryS = [408, 429, 503].includes(answer.status) ? Math.min(30, Number(answer.headers.get("Retry-After")) || 2) : 0;
  const problem = await answer.json().catch(() => null);
  const unknown = { title: `The server answers with ${answer.status}`, detail: answer.statusText || "without a reason" };
  throw new ApiProblem(answer.status, typeof problem?.title === "string" ? problem : unknown, retryS);
}
