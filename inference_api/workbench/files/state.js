// What is shown, as a value and as an address that opens the same scene.

/** @import {Configuration, Disc} from "./geometry.js" */

/**
 * @typedef {object} State
 * @property {Disc[]} discs
 * @property {string | null} picture  Base64 of a dropped PNG that replaces the discs.
 * @property {Configuration} start
 * @property {Configuration} goal
 * @property {string} model  Empty for the default model.
 * @property {number} n
 * @property {string} seed  Decimal digits, because seeds have 64 bits.
 * @property {number | null} confidence  Minimum of the samples; null for the model's threshold.
 * @property {string} planSeed
 * @property {number} limit  Time limit of the search, s.
 * @property {number} paths
 * @property {number | null} minConfidence  Minimum of a path; null for the model's default.
 * @property {"truth" | "prediction" | "none"} ground  What lies under the samples.
 */

export const MAX_DISCS = 64;
// Longer addresses are cut by mail and chat programs.
const MAX_PICTURE = 6000;

/** @returns {State} */
export const usual = () => ({
  discs: [
    { x: 2.6, y: 1.9, r: 1 },
    { x: -1.9, y: 2.5, r: 1 },
    { x: 0.5, y: -3.2, r: 1 },
  ],
  picture: null,
  start: [0, 0.3],
  goal: [-2.6, -0.6],
  model: "",
  n: 300,
  seed: "7",
  confidence: null,
  planSeed: "7",
  limit: 5,
  paths: 4,
  minConfidence: null,
  ground: "truth",
});

/** @param {string | null | undefined} text */
export const isSeed = (text) => /^[0-9]{1,20}$/.test(text ?? "");

/** @param {number} value */
const short = (value) => String(Number(value.toFixed(3)));

/** The part of an address behind its #. @param {State} state */
export function toHash(state) {
  const fields = new URLSearchParams();
  if (state.picture && state.picture.length <= MAX_PICTURE) fields.set("picture", state.picture);
  fields.set("discs", state.discs.map(({ x, y, r }) => [x, y, r].map(short).join(",")).join(";"));
  fields.set("start", state.start.map(short).join(","));
  fields.set("goal", state.goal.map(short).join(","));
  if (state.model) fields.set("model", state.model);
  fields.set("n", String(state.n));
  fields.set("seed", state.seed);
  if (state.confidence !== null) fields.set("confidence", short(state.confidence));
  const least = state.minConfidence === null ? [] : [short(state.minConfidence)];
  fields.set("plan", [state.planSeed, short(state.limit), state.paths, ...least].join());
  if (state.ground !== "truth") fields.set("ground", state.ground);
  return `#${fields.toString().replaceAll("%2C", ",").replaceAll("%3B", ";").replaceAll("%2F", "/")}`;
}

/** The inverse; what is missing or wrong is as usual. @param {string} hash @returns {State} */
export function fromHash(hash) {
  const fields = new URLSearchParams(hash.replace(/^#/, ""));
  const state = usual();
  const discs = fields.get("discs");
  if (discs !== null) {
    const rows = discs.split(";").map(numbers).filter((row) => row.length === 3 && row[2] > 0);
    state.discs = rows.slice(0, MAX_DISCS).map(([x, y, r]) => ({ x, y, r }));
  }
  for (const end of /** @type {const} */ (["start", "goal"])) {
    const angles = numbers(fields.get(end) ?? "");
    if (angles.length > 0) state[end] = angles;
  }
  const picture = fields.get("picture");
  if (picture && /^[A-Za-z0-9+/]+=*$/.test(picture)) state.picture = picture;
  state.model = (fields.get("model") ?? "").slice(0, 200);
  state.n = clamp(fields.get("n"), 1, 2000, state.n, true);
  const seed = fields.get("seed");
  if (seed && isSeed(seed)) state.seed = seed;
  if (fields.has("confidence")) state.confidence = clamp(fields.get("confidence"), 0, 1, 0.5, false);
  const [planSeed, limit, paths, least] = (fields.get("plan") ?? "").split(",");
  if (isSeed(planSeed)) state.planSeed = planSeed;
  state.limit = clamp(limit, 0.01, 10, state.limit, false);
  state.paths = clamp(paths, 1, 64, state.paths, true);
  if (least) state.minConfidence = clamp(least, 0, 1, 0, false);
  const ground = fields.get("ground");
  if (ground === "prediction" || ground === "none") state.ground = ground;
  return state;
}

/** @param {string} text */
function numbers(text) {
  const found = text.split(",").map((part) => (part.trim() === "" ? NaN : Number(part)));
  return found.every((value) => Number.isFinite(value) && Math.abs(value) < 1e3) ? found : [];
}

/** @param {string | null | undefined} text @param {number} low @param {number} high @param {number} otherwise @param {boolean} whole */
export function clamp(text, low, high, otherwise, whole) {
  const value = text?.trim() ? Number(text) : NaN;
  if (!Number.isFinite(value)) return otherwise;
  return Math.min(high, Math.max(low, whole ? Math.round(value) : value));
}
