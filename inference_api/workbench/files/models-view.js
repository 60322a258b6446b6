// The models that are served: where they come from, how they were evaluated, and what they are called.

import { entry } from "./messages.js";
import { byId } from "./svg.js";

/**
 * @typedef {{reference: string, name: string, version: number, aliases: string[], run_id: string | null,
 *   digest: string, loaded: boolean, default: boolean, robot: string | null, world: any, joint_space: any}} Listed
 * @typedef {[string, string][]} Rows  Names and what they stand for.
 * @typedef {{reference: string, rows: Rows, further: Rows, link: string | null}} Story
 */

const REGISTRY = {
  none: "This server has no model registry; it serves the shipped models.",
  reachable: "The model registry answers.",
  unreachable: "The model registry is not reachable; the server uses the shipped and the cached models.",
};

/**
 * @param {Listed[]} models
 * @param {{models: Story[], champions: Rows}} details
 * @param {keyof REGISTRY} registry
 * @param {(reference: string) => void} use
 */
export function showModels(models, details, registry, use) {
  byId("registry").textContent = REGISTRY[registry];
  const champions = details.champions.length ? [folded("Champion history", details.champions, true)] : [];
  byId("model-list").replaceChildren(
    ...champions,
    ...models.map((model) => card(model, details.models.find(({ reference }) => reference === model.reference), use)),
  );
}

/**
 * @param {Listed} model
 * @param {Story | undefined} story
 * @param {(reference: string) => void} use
 */
function card(model, story, use) {
  const article = entry("article", "", "card");
  const title = entry("h3");
  const names = [...model.aliases, ...(model.default ? ["default"] : [])];
  title.append(model.reference, ...names.map((name) => entry("span", name, "alias")));
  article.append(title, table([...(story?.rows ?? []), ...rowsOf(model)]));
  if (story?.further.length) article.append(folded(`${story.further.length} more metrics`, story.further));
  const bar = entry("div", "", "bar");
  if (model.world?.kind === "planar") {
    const button = entry("button", "Use it");
    button.type = "button";
    button.setAttribute("aria-label", `Use ${model.reference}`);
    button.addEventListener("click", () => use(model.reference));
    bar.append(button);
  }
  if (story?.link) bar.append(Object.assign(entry("a", "In MLflow"), { href: story.link, rel: "noreferrer" }));
  article.append(bar);
  return article;
}

/** What the model's place in the list tells. @param {Listed} model @returns {Rows} */
function rowsOf({ joint_space: space, world, run_id: run, digest, loaded }) {
  const kind = space ? `${space.kind}, ${space.dim} joints` : "";
  const details = { "joint space": kind, world: world?.kind, run, digest, loaded: loaded ? "yes" : "no" };
  return Object.entries(details).filter(([, text]) => text);
}

/** @param {Rows} rows */
function table(rows) {
  const list = entry("dl");
  list.append(...rows.flatMap(([name, text]) => [entry("dt", name), entry("dd", text)]));
  return list;
}

/** @param {string} words @param {Rows} rows @param {boolean} [open] */
function folded(words, rows, open = false) {
  const details = entry("details", "", open ? "card" : "");
  details.open = open;
  details.append(entry("summary", words), table(rows));
  return details;
}
