// What is shown, to take along: a command, a script, a link.

/** @import {Workbench} from "./main.js" */

import { toHash } from "./state.js";
import { byId, selectOf } from "./svg.js";

/** @typedef {"curl" | "python" | "link"} Form */

/**
 * @param {Workbench} bench
 * @param {(what: "sample" | "plan", form: "curl" | "python") => Promise<string>} textOf
 */
export function listenToCopies(bench, textOf) {
  for (const form of /** @type {const} */ (["curl", "python", "link"])) {
    byId(`take-${form}`).addEventListener("click", () => void copy(bench, form, textOf));
  }
}

/**
 * @param {Workbench} bench
 * @param {Form} form
 * @param {(what: "sample" | "plan", form: "curl" | "python") => Promise<string>} textOf
 */
async function copy(bench, form, textOf) {
  const what = /** @type {"sample" | "plan"} */ (selectOf("take-what").value);
  const text = form === "link" ? new URL(toHash(bench.state), location.href).href : await textOf(what, form);
  const area = byId("take-text", HTMLTextAreaElement);
  area.value = text;
  area.hidden = false;
  const copied = byId("take-told");
  try {
    await navigator.clipboard.writeText(text);
    copied.textContent = "Copied.";
  } catch {
    area.select();
    copied.textContent = "The browser does not let the page copy; here it is.";
  }
  if (form === "link" && bench.state.picture && !text.includes("picture=")) {
    copied.textContent += " The picture is too large for a link: send it beside it.";
  }
}
