// What is shown as a request to take along.

/** @import {Workbench} from "./main.js" */

import { hasKey } from "./api.js";
import { byId, selectOf } from "./svg.js";

/** @typedef {"sample" | "plan"} Endpoint */

/** @param {Workbench} bench */
export function listenToCopies(bench) {
  byId("take-curl").addEventListener("click", () => void copy(bench, asCurl));
  byId("take-python").addEventListener("click", () => void copy(bench, asPython));
}

/** @param {Workbench} bench @param {(address: string, endpoint: Endpoint, body: object) => string} write */
async function copy(bench, write) {
  const endpoint = /** @type {Endpoint} */ (selectOf("take-what").value);
  const body = await bench.body(endpoint);
  if (!body) return;
  const area = byId("take-text", HTMLTextAreaElement);
  area.value = write(new URL(endpoint, location.href).href, endpoint, body);
  area.hidden = false;
  const status = byId("take-status");
  try {
    await navigator.clipboard.writeText(area.value);
    status.textContent = "Copied.";
  } catch {
    area.select();
    status.textContent = "The browser blocks copying; copy the text below.";
  }
}

/** @param {string} address @param {Endpoint} _ @param {object} body */
function asCurl(address, _, body) {
  const key = hasKey() ? " \\\n  -H \"Authorization: Bearer $CSPACE_API_KEY\"" : "";
  return `curl -fsS ${address} -H 'Content-Type: application/json'${key} \\\n  -d '${JSON.stringify(body)}'\n`;
}

/** @param {string} address @param {Endpoint} endpoint @param {object} body */
function asPython(address, endpoint, body) {
  const key = hasKey();
  const headers = key ? ', headers={"Authorization": f"Bearer {os.environ[\'CSPACE_API_KEY\']}"}' : "";
  return [
    ...(key ? ["import os", ""] : []),
    "import httpx",
    "",
    "body = {",
    ...Object.entries(body).map(([name, value]) => `    ${JSON.stringify(name)}: ${JSON.stringify(value)},`),
    "}",
    `answer = httpx.post("${address}", json=body, timeout=60.0${headers}).raise_for_status().json()`,
    `print(${endpoint === "sample" ? 'answer["samples"]' : 'answer["status"], answer["path"]'})`,
    "",
  ].join("\n");
}
