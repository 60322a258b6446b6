// A path from start to goal: asked for, checked independently where the truth is known, and played.

/** @import {Workbench} from "./main.js" */
/** @import {Side} from "./side.js" */

import { ask } from "./api.js";
import { degrees } from "./geometry.js";
import { Player } from "./player.js";
import { buttonOf, byId } from "./svg.js";

const PLAY_MS = 4000;
// As many paths as the server grows trees about.
const MOST_WAYS = 8;
export const LOOKING = "Searching for a path. The first one after an installation takes up to a minute.";
const STATUS = { refused: "Refused", timeout: "Timed out", exhausted: "Not solved" };

/**
 * @typedef {{free: boolean, edges: boolean[]}} Way  What is true of a path.
 *
 * @typedef {object} Planned
 * @property {any} answer  Of POST /plan, or of a planner that grew trees.
 * @property {Way | null} way  Null where nobody knows.
 */

export class Planner {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    this.player = new Player("play", "along", PLAY_MS, () => bench.draw());
    this.asking = 0;
    this.told = byId("plan-told");
    this.button = buttonOf("plan");
    this.button.addEventListener("click", () => void this.plan());
  }

  /** What was planned does not fit any more. */
  forget() {
    const { first, beside } = this.bench;
    this.asking += 1;
    if (!first.planned && !beside.planned && this.told.textContent === "") return;
    first.planned = beside.planned = null;
    this.player.load(false);
    this.bench.readout.show();
    say(this.told, "");
    this.showConfidence();
  }

  /** Ask one model after the other, so that none waits for another's search. */
  async plan() {
    const { bench } = this;
    this.forget();
    const asking = this.asking;
    const sides = bench.sides();
    say(this.told, bench.about.plans ? LOOKING : "Planning.");
    this.button.disabled = true;
    try {
      for (const side of sides) {
        const answer = bench.grows ? await this.grow(side) : await ask("plan", await side.body("plan"));
        if (asking !== this.asking) return;
        side.planned = { answer, way: answer.way ?? null };
        this.tell(sides);
        if (!bench.grows) side.planned.way = await this.check(side);
        if (asking !== this.asking) return;
        this.tell(sides);
      }
      bench.messages.clear();
      if (sides.some((side) => side.way.length > 1)) {
        this.player.load(true);
        this.player.begin();
      }
    } catch (error) {
      if (!bench.first.planned) say(this.told, "");
      bench.messages.failed(error);
    } finally {
      this.button.disabled = false;
    }
  }

  /** Trees among the discs themselves, fed with what is chosen. @param {Side} side */
  async grow(side) {
    const { start, goal, planSeed, limit, budget, planner, feed } = this.bench.state;
    const body = {
      ...side.model, ...this.bench.discs(), start, goal, planner, seed: planSeed, max_iterations: budget, time_limit_s: limit,
    };
    if (feed === "shown") return ask("workbench/search", { ...body, samples: side.drawn.samples });
    if (feed === "uniform") return ask("workbench/search", body);
    // All paths that the model finds, at any confidence: the checks decide.
    const asked = { ...(await side.body("plan")), alternatives: true, min_confidence: 0 };
    const { alternatives } = await ask("plan", asked);
    const ways = alternatives.slice(0, MOST_WAYS).map((/** @type {any} */ { path }) => path);
    return ask("workbench/search", { ...body, ways });
  }

  /** Check the path against the discs themselves. @param {Side} side */
  async check(side) {
    const { state, about } = this.bench;
    if (!about.truth || state.picture || side.way.length < 2) return null;
    return (await ask("workbench/truth", { ...side.model, ...this.bench.discs(), cells: 8, path: side.way })).way;
  }

  /** @param {Side[]} sides */
  tell(sides) {
    const planned = sides.filter((side) => side.planned);
    const two = sides.length > 1;
    const words = planned.map((side) => (two ? `${side.title}: ` : "") + wordsOf(/** @type {Planned} */ (side.planned), two));
    say(this.told, words.join(" "), planned.some(({ planned }) => planned?.answer.status !== "solved" || planned.way?.free === false));
    this.showConfidence();
    this.bench.readout.show();
    this.bench.draw();
  }

  /** Confidence of the first model’s path, edge by edge, and where lowest; or what its trees have cost. */
  showConfidence() {
    const { first } = this.bench;
    const { edges } = first.uncertainty;
    const answer = first.planned?.answer;
    const least = answer?.least_sure;
    const told = [];
    if (least) {
      const angles = least.configuration.map(degrees).join(", ");
      told.push(`Lowest confidence ${least.confidence.toFixed(3)} after ${Math.round(100 * least.along)} % of the path: ${angles}.`);
    }
    if (edges.length) told.push(`Per edge: ${edges.map((one) => one.toFixed(3)).join(", ")}.`);
    if (answer?.iterations) {
      told.push(
        `${answer.edge_checks} edges and ${answer.state_checks} states checked; ${answer.learned_drawn} of ` +
          `${answer.iterations} samples were not uniform; ${answer.nodes.length} nodes.`,
      );
    }
    byId("plan-confidence").textContent = told.join(" ");
  }
}

/** @param {Planned} planned @param {boolean} brief  Where a table tells the rest. */
function wordsOf({ answer, way }, brief) {
  if (answer.status !== "solved") return `${STATUS[/** @type {keyof STATUS} */ (answer.status)]}: ${answer.reason}.`;
  if (brief) return "solved.";
  const rest = answer.nodes
    ? `${answer.iterations} iterations.`
    : `confidence ${answer.confidence.toFixed(3)}, best of ${answer.ways} paths.`;
  const words = `Solved in ${searchedMs(answer)} ms: ${answer.length_rad.toFixed(2)} rad, ${rest}`;
  return way ? `${words} Checked against the discs: ${verdictOf(way)}.` : words;
}

/** @param {HTMLElement} place @param {string} words @param {boolean} [bad] */
export function say(place, words, bad = false) {
  place.textContent = words;
  place.classList.toggle("bad", bad);
}

/** @param {Way} way */
export function verdictOf({ free, edges }) {
  return free ? "collision-free" : `collides on ${edges.filter((one) => !one).length} of ${edges.length} edges`;
}

/** @param {any} answer  Of POST /plan, or of trees, which take less. */
export function searchedMs({ timing_ms: took, search_ms: grew }) {
  return took ? Math.round(took.search + took.score) : grew.toFixed(1);
}
