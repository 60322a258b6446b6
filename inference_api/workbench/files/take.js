// What is shown, to take along: a command, a script, a link.

/** @import {Workbench} from "./main.js" */

import { toHash } from "./state.js";
import { byId } from "./svg.js";

/** @typedef {"curl" | "python" | "link"} Form */

/**
 * @param {Workbench} bench
 * @param {string} prefix  Of the ids of what belongs together.
 * @param {(what: "sample" | "plan", form: "curl" | "python") => Promise<string>} textOf
 */
export function listenToCopies(bench, prefix, textOf) {
  for (const form of /** @type {const} */ (["curl", "python", "link"])) {
    byId(`${prefix}-${form}`, HTMLButtonElement).addEventListener("click", () => void copy(bench, prefix, form, textOf));
  }
}

/**
 * @param {Workbench} bench
 * @param {string} prefix
 * @param {Form} form
 * @param {(what: "sample" | "plan", form: "curl" | "python") => Promise<string>} textOf
 */
async function copy(bench, prefix, form, textOf) {
  const what = /** @type {"sample" | "plan"} */ (byId(`${prefix}-what`, HTMLSelectElement).value);
  const text = form === "link" ? new URL(toHash(bench.state), location.href).href : await textOf(what, form);
  const area = byId(`${prefix}-text`, HTMLTextAreaElement);
  area.value = text;
  area.hidden = false;
  const copied = byId(`${prefix}-told`, HTMLElement);
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
