// The models that can be asked: where they come from, how they were judged, and what they are called.

import { entry } from "./messages.js";
import { byId } from "./svg.js";

/**
 * @typedef {{reference: string, name: string, version: number, aliases: string[], run_id: string | null,
 *   digest: string, loaded: boolean, default: boolean, robot: string | null, world: any, joint_space: any}} Listed
 * @typedef {{promoted: boolean, reasons: string[], against: number | null, created_ms: number}} Decided
 * @typedef {{reference: string, created: string | null, figures: Record<string, number>, decisions: Decided[],
 *   lineage: Record<string, string>, link: string | null}} Story
 */

const REGISTRY = {
  none: "This server has no model registry; it serves what ships with it.",
  reachable: "The model registry answers.",
  unreachable: "The model registry does not answer now; what is here is served from what is known.",
};

/**
 * @param {Listed[]} models
 * @param {Story[]} stories
 * @param {keyof REGISTRY} registry
 * @param {(reference: string) => void} use
 */
export function showModels(models, stories, registry, use) {
  byId("registry").textContent = REGISTRY[registry];
  const byReference = new Map(stories.map((story) => [story.reference, story]));
  byId("model-list").replaceChildren(
    ...models.map((model) => card(model, byReference.get(model.reference), use)),
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
  title.append(model.reference, ...[...model.aliases, ...(model.default ? ["default"] : [])].map(badge));
  article.append(title, table(rows(model, story)));
  const further = Object.entries(story?.figures ?? {}).filter(([name]) => !isHeadline(name));
  if (further.length) {
    const details = entry("details");
    const summary = entry("summary", `${further.length} further figures`);
    details.append(summary, table(further.map(figure)));
    article.append(details);
  }
  const bar = entry("div", "", "bar");
  if (model.world?.kind === "planar") bar.append(useButton(model.reference, use));
  if (story?.link) bar.append(linkTo(story.link));
  if (bar.childElementCount) article.append(bar);
  return article;
}

/**
 * @param {Listed} model
 * @param {Story | undefined} story
 * @returns {[string, string][]}
 */
function rows(model, story) {
  /** @type {[string, string][]} */
  const found = [];
  found.push(...Object.entries(story?.figures ?? {}).filter(([name]) => isHeadline(name)).map(figure));
  const space = model.joint_space;
  if (space) found.push(["joint space", `${space.kind}, ${space.dim} joints`]);
  if (model.world) found.push(["world", model.world.kind]);
  if (story?.created) found.push(["made", when(story.created)]);
  for (const [name, text] of Object.entries(story?.lineage ?? {})) found.push([name.replaceAll("_", " "), text]);
  if (model.run_id) found.push(["run", model.run_id]);
  found.push(["digest", model.digest], ["in memory", model.loaded ? "yes" : "no"]);
  for (const one of story?.decisions ?? []) {
    const verdict = one.promoted ? "promoted" : "not promoted";
    const against = one.against ? ` against version ${one.against}` : "";
    found.push([when(String(one.created_ms)), `${verdict}${against}: ${one.reasons.join("; ")}`]);
  }
  return found;
}

/** Figures with a path in their name are parts of something larger. @param {string} name */
function isHeadline(name) {
  return !name.includes("/");
}

/** @param {[string, number]} named @returns {[string, string]} */
function figure([name, value]) {
  return [name.replaceAll("_", " "), String(Number(value.toPrecision(4)))];
}

/** @param {[string, string][]} rows */
function table(rows) {
  const list = entry("dl");
  for (const [name, text] of rows) list.append(entry("dt", name), entry("dd", text));
  return list;
}

/** @param {string} text  ISO 8601, or milliseconds since 1970. */
function when(text) {
  const date = new Date(/^\d+$/.test(text) ? Number(text) : text);
  return Number.isNaN(date.valueOf()) ? text : date.toISOString().slice(0, 16).replace("T", " ") + " UTC";
}

/** @param {string} text */
function badge(text) {
  const found = entry("span", "", "alias");
  found.textContent = text;
  return found;
}

/** @param {string} reference @param {(reference: string) => void} use */
function useButton(reference, use) {
  const button = entry("button");
  button.type = "button";
  button.textContent = "Use it";
  button.setAttribute("aria-label", `Use ${reference}`);
  button.addEventListener("click", () => use(reference));
  return button;
}

/** @param {string} address */
function linkTo(address) {
  const link = entry("a");
  link.href = address;
  link.textContent = "In MLflow";
  link.rel = "noreferrer";
  return link;
}
