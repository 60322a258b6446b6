// What is shown, to take along: a command, a script, a link.

/** @import {Workbench} from "./main.js" */

import { hasKey } from "./api.js";
import { toHash } from "./state.js";
import { byId, selectOf } from "./svg.js";

/** @typedef {"curl" | "python" | "link"} Form */
/** @typedef {"sample" | "plan"} Page  Of the API. */

/** @param {Workbench} bench */
export function listenToCopies(bench) {
  for (const form of /** @type {const} */ (["curl", "python", "link"])) {
    byId(`take-${form}`).addEventListener("click", () => void copy(bench, form));
  }
}

/** @param {Workbench} bench @param {Form} form */
async function copy(bench, form) {
  const text = await textOf(bench, form);
  const area = byId("take-text", HTMLTextAreaElement);
  area.value = text;
  area.hidden = false;
  const copied = byId("take-status");
  try {
    await navigator.clipboard.writeText(text);
    copied.textContent = "Copied.";
  } catch {
    area.select();
    copied.textContent = "The browser blocks copying; copy the text below.";
  }
  if (form === "link" && bench.state.picture && !text.includes("picture=")) {
    copied.textContent += " The picture is too large for a link; send it separately.";
  }
}

/** @param {Workbench} bench @param {Form} form */
async function textOf(bench, form) {
  if (form === "link") return new URL(toHash(bench.state), location.href).href;
  const page = /** @type {Page} */ (selectOf("take-what").value);
  const body = await bench.first.body(page);
  const address = new URL(page, location.href).href.replace(/#.*$/, "");
  return (form === "curl" ? asCurl : asPython)(address, page, body);
}

/** @param {string} address @param {Page} _page @param {object} body */
function asCurl(address, _page, body) {
  const authorization = hasKey() ? " \\\n  -H \"Authorization: Bearer $CSPACE_API_KEY\"" : "";
  return (
    `curl -fsS ${address} -H 'Content-Type: application/json'${authorization} \\\n` +
    `  -d '${JSON.stringify(body)}'\n`
  );
}

/** @param {string} address @param {Page} page @param {object} body */
function asPython(address, page, body) {
  const fields = Object.entries(body).map(([name, value]) => `    ${JSON.stringify(name)}: ${JSON.stringify(value)},`);
  const key = hasKey();
  const headers = key ? ', headers={"Authorization": f"Bearer {os.environ[\'CSPACE_API_KEY\']}"}' : "";
  return [
    ...(key ? ["import os", ""] : []),
    "import httpx",
    "",
    "body = {",
    ...fields,
    "}",
    `answer = httpx.post("${address}", json=body, timeout=60.0${headers}).raise_for_status().json()`,
    `print(${page === "sample" ? 'answer["samples"]' : 'answer["status"], answer["path"]'})`,
    "",
  ].join("\n");
}
