// What is shown, as a value and as an address that a colleague can open.

/** @import {Configuration, Disc} from "./geometry.js" */

/**
 * @typedef {"" | "RRTConnect" | "RRT"} Planner  Which grows trees among the discs; empty for POST /plan.
 * @typedef {"uniform" | "shown" | "ways"} Feed  What trees sample from: the shown samples, or about the model’s paths.
 *
 * @typedef {object} State
 * @property {Disc[]} discs
 * @property {string | null} picture  Base64 of an uploaded PNG that is shown instead of discs.
 * @property {Configuration} start
 * @property {Configuration} goal
 * @property {string} model  As requests name it; empty for the default one.
 * @property {string} beside  Likewise, of the model that is compared with it; empty for none.
 * @property {number} n
 * @property {string} seed  Decimal digits, for seeds have 64 bits.
 * @property {number | null} confidence  What samples have to score; null for the model's own threshold.
 * @property {string} planSeed  As the seed, of plans.
 * @property {number} limit  Time limit of the search, s.
 * @property {number} paths  How many are looked for.
 * @property {Planner} planner
 * @property {Feed} feed
 * @property {number} budget  Iterations of a planner that grows trees.
 * @property {number | null} minConfidence  Of a path; null for the default of the model.
 * @property {"truth" | "prediction" | "none"} ground  What lies under the samples.
 * @property {"plane" | "models"} view
 */

const NAMES = /** @type {const} */ (["model", "beside"]);
export const MAX_DISCS = 64;
// An address longer than this is cut by what people send it with.
const MAX_PICTURE = 6000;

/** @returns {State} */
export function usual() {
  return {
    discs: [
      { x: 2.6, y: 1.9, r: 1 },
      { x: -1.9, y: 2.5, r: 1 },
      { x: 0.5, y: -3.2, r: 1 },
    ],
    picture: null,
    start: [0, 0.3],
    goal: [-2.6, -0.6],
    model: "",
    beside: "",
    n: 300,
    seed: "7",
    confidence: null,
    planSeed: "7",
    limit: 5,
    paths: 4,
    minConfidence: null,
    planner: "",
    feed: "shown",
    budget: 2000,
    ground: "truth",
    view: "plane",
  };
}

/** @param {State} state */
const planOf = ({ planSeed, limit, paths, minConfidence }) =>
  [planSeed, short(limit), paths, ...(minConfidence === null ? [] : [short(minConfidence)])].join();
/** @param {State} state */
const searchOf = ({ planner, feed, budget }) => [planner, feed, budget].join();

/** What a seed is. @param {string | null | undefined} text */
export const isSeed = (text) => /^[0-9]{1,20}$/.test(text ?? "");

/** @param {number} value */
const short = (value) => String(Number(value.toFixed(3)));

/**
 * The part of an address behind its #.
 * @param {State} state
 */
export function toHash(state) {
  const fields = new URLSearchParams();
  if (state.view !== "plane") fields.set("view", state.view);
  if (state.picture && state.picture.length <= MAX_PICTURE) fields.set("picture", state.picture);
  fields.set("discs", state.discs.map((disc) => [disc.x, disc.y, disc.r].map(short).join(",")).join(";"));
  fields.set("start", state.start.map(short).join(","));
  fields.set("goal", state.goal.map(short).join(","));
  for (const name of NAMES) if (state[name]) fields.set(name, state[name]);
  fields.set("n", String(state.n));
  fields.set("seed", state.seed);
  if (state.confidence !== null) fields.set("confidence", short(state.confidence));
  const plan = planOf(state);
  if (plan !== planOf(usual())) fields.set("plan", plan);
  if (searchOf(state) !== searchOf(usual())) fields.set("search", searchOf(state));
  if (state.ground !== "truth") fields.set("ground", state.ground);
  return `#${fields.toString().replaceAll("%2C", ",").replaceAll("%3B", ";").replaceAll("%2F", "/")}`;
}

/**
 * The inverse; what is missing or wrong is as usual.
 * @param {string} hash
 * @returns {State}
 */
export function fromHash(hash) {
  const fields = new URLSearchParams(hash.replace(/^#/, ""));
  const state = usual();
  const discs = fields.get("discs");
  if (discs !== null) state.discs = readDiscs(discs);
  for (const name of /** @type {const} */ (["start", "goal"])) {
    const angles = numbers(fields.get(name) ?? "");
    if (angles.length > 0) state[name] = angles;
  }
  const picture = fields.get("picture");
  if (picture && /^[A-Za-z0-9+/]+=*$/.test(picture)) state.picture = picture;
  for (const name of NAMES) state[name] = (fields.get(name) ?? "").slice(0, 200);
  state.n = clamp(fields.get("n"), 1, 2000, state.n, true);
  const seed = fields.get("seed");
  if (seed && isSeed(seed)) state.seed = seed;
  const [planSeed, limit, paths, minConfidence] = (fields.get("plan") ?? "").split(",");
  if (isSeed(planSeed)) state.planSeed = planSeed;
  state.limit = clamp(limit, 0.01, 10, state.limit, false);
  state.paths = clamp(paths, 1, 64, state.paths, true);
  if (minConfidence) state.minConfidence = clamp(minConfidence, 0, 1, 0, false);
  const [planner, feed, budget] = (fields.get("search") ?? "").split(",");
  if (planner === "RRT" || planner === "RRTConnect") state.planner = planner;
  if (feed === "uniform" || feed === "ways") state.feed = feed;
  state.budget = clamp(budget, 1, 20000, state.budget, true);
  if (fields.has("confidence")) state.confidence = clamp(fields.get("confidence"), 0, 1, 0.5, false);
  const ground = fields.get("ground");
  if (ground === "prediction" || ground === "none") state.ground = ground;
  const view = fields.get("view");
  if (view === "models") state.view = view;
  return state;
}

/** @param {string} text @returns {Disc[]} */
function readDiscs(text) {
  const rows = text.split(";").map(numbers).filter((row) => row.length === 3 && row[2] > 0);
  return rows.slice(0, MAX_DISCS).map(([x, y, r]) => ({ x, y, r }));
}

/** @param {string} text */
function numbers(text) {
  const found = text.split(",").map((part) => (part.trim() === "" ? NaN : Number(part)));
  return found.every((value) => Number.isFinite(value) && Math.abs(value) < 1e3) ? found : [];
}

/**
 * @param {string | null | undefined} text
 * @param {number} low
 * @param {number} high
 * @param {number} otherwise
 * @param {boolean} whole
 */
export function clamp(text, low, high, otherwise, whole) {
  const value = text?.trim() ? Number(text) : NaN;
  if (!Number.isFinite(value)) return otherwise;
  return Math.min(high, Math.max(low, whole ? Math.round(value) : value));
}
