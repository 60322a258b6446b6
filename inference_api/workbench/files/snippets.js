// What is shown, as commands that ask for the same again.

/** @import {State} from "./state.js" */

/**
 * The request for the samples that are shown.
 * @param {State} state
 * @param {string} image  Base64 of a PNG.
 */
export function sampleBody(state, image) {
  return {
    image,
    n: state.n,
    seed: state.seed,
    ...(state.confidence === null ? {} : { min_confidence: state.confidence }),
  };
}

/**
 * The request for the way that is shown.
 * @param {State} state
 * @param {string} image  Base64 of a PNG.
 */
export function planBody(state, image) {
  return {
    image,
    start: state.start,
    goal: state.goal,
    seed: state.planSeed,
    time_limit_s: state.limit,
    ways: state.ways,
  };
}

/**
 * @param {string} address  Of the server.
 * @param {"sample" | "plan"} page
 * @param {object} body
 * @param {boolean} key  Whether the server asks for one.
 */
export function asCurl(address, page, body, key) {
  const authorization = key ? " \\\n  -H \"Authorization: Bearer $CSPACE_API_KEY\"" : "";
  return (
    `curl -fsS ${address}/${page} -H 'Content-Type: application/json'${authorization} \\\n` +
    `  -d '${JSON.stringify(body)}'\n`
  );
}

/**
 * @param {string} address  Of the server.
 * @param {"sample" | "plan"} page
 * @param {object} body
 * @param {boolean} key  Whether the server asks for one.
 */
export function asPython(address, page, body, key) {
  const fields = Object.entries(body).map(([name, value]) => `    ${JSON.stringify(name)}: ${JSON.stringify(value)},`);
  const headers = key ? ', headers={"Authorization": f"Bearer {os.environ[\'CSPACE_API_KEY\']}"}' : "";
  const told = page === "sample" ? 'answer["samples"]' : 'answer["status"], answer["path"]';
  return [
    ...(key ? ["import os", ""] : []),
    "import httpx",
    "",
    "body = {",
    ...fields,
    "}",
    `answer = httpx.post("${address}/${page}", json=body, timeout=60.0${headers}).raise_for_status().json()`,
    `print(${told})`,
    "",
  ].join("\n");
}
