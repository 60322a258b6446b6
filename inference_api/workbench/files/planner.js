// A path from start to goal: requested, checked where the ground truth is known, and played.

/** @import {Workbench} from "./main.js" */
/** @import {Side} from "./side.js" */

import { ask } from "./api.js";
import { degrees } from "./geometry.js";
import { Player } from "./player.js";
import { buttonOf, byId } from "./svg.js";

const PLAY_MS = 4000;
// As many paths as the server grows trees about.
const MOST_PATHS = 8;
export const LOOKING = "Searching for a path. The first one after an installation takes up to a minute.";
const STATUS = { refused: "Refused", timeout: "Timed out", exhausted: "Not solved" };

/**
 * @typedef {{free: boolean, edges: boolean[]}} Verdict  Of a path, by the ground truth.
 *
 * @typedef {object} Planned
 * @property {any} answer  Of POST /plan, or of a planner that grew trees.
 * @property {Verdict | null} verdict  Null where nobody knows.
 */

export class Planner {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    this.player = new Player("play", "along", PLAY_MS, () => bench.draw());
    this.round = 0;
    this.status = byId("plan-status");
    this.button = buttonOf("plan");
    this.button.addEventListener("click", () => void this.plan());
  }

  /** What was planned does not fit any more. */
  forget() {
    const { first, beside } = this.bench;
    this.round += 1;
    if (!first.planned && !beside.planned && this.status.textContent === "") return;
    first.planned = beside.planned = null;
    this.player.load(false);
    this.bench.readout.show();
    say(this.status, "");
    this.showConfidence();
  }

  /** Ask one model after the other, so that none waits for another's search. */
  async plan() {
    const { bench } = this;
    this.forget();
    const round = this.round;
    const sides = bench.sides();
    say(this.status, bench.about.plans ? LOOKING : "Planning.");
    this.button.disabled = true;
    try {
      for (const side of sides) {
        const answer = bench.grows ? await this.grow(side) : await ask("plan", await side.body("plan"));
        if (round !== this.round) return;
        side.planned = { answer, verdict: answer.path_verdict ?? null };
        this.report(sides);
        if (!bench.grows) side.planned.verdict = await this.check(side);
        if (round !== this.round) return;
        this.report(sides);
      }
      bench.messages.clear();
      if (sides.some((side) => side.path.length > 1)) {
        this.player.load(true);
        this.player.begin();
      }
    } catch (error) {
      if (!bench.first.planned) say(this.status, "");
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
    if (feed === "shown") return ask("workbench/search", { ...body, samples: side.shown.samples });
    if (feed === "uniform") return ask("workbench/search", body);
    // All paths that the model finds, at any confidence: the checks decide.
    const request = { ...(await side.body("plan")), alternatives: true, min_confidence: 0 };
    const { alternatives } = await ask("plan", request);
    const paths = alternatives.slice(0, MOST_PATHS).map((/** @type {any} */ { path }) => path);
    return ask("workbench/search", { ...body, paths });
  }

  /** Check the path against the discs themselves. @param {Side} side */
  async check(side) {
    const { state, about } = this.bench;
    if (!about.truth || state.picture || side.path.length < 2) return null;
    return (await ask("workbench/truth", { ...side.model, ...this.bench.discs(), cells: 8, path: side.path })).path_verdict;
  }

  /** @param {Side[]} sides */
  report(sides) {
    const planned = sides.filter((side) => side.planned);
    const two = sides.length > 1;
    const words = planned.map((side) => (two ? `${side.title}: ` : "") + wordsOf(/** @type {Planned} */ (side.planned), two));
    say(this.status, words.join(" "), planned.some(({ planned }) => planned?.answer.status !== "solved" || planned.verdict?.free === false));
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
    const lines = [];
    if (least) {
      const angles = least.configuration.map(degrees).join(", ");
      lines.push(`Lowest confidence ${least.confidence.toFixed(3)} after ${Math.round(100 * least.along)} % of the path: ${angles}.`);
    }
    if (edges.length) lines.push(`Per edge: ${edges.map((one) => one.toFixed(3)).join(", ")}.`);
    if (answer?.iterations) {
      lines.push(
        `${answer.edge_checks} edges and ${answer.state_checks} states checked; ${answer.learned_drawn} of ` +
          `${answer.iterations} samples were not uniform; ${answer.nodes.length} nodes.`,
      );
    }
    byId("plan-confidence").textContent = lines.join(" ");
  }
}

/** @param {Planned} planned @param {boolean} brief  Where a table shows the rest. */
function wordsOf({ answer, verdict }, brief) {
  if (answer.status !== "solved") return `${STATUS[/** @type {keyof STATUS} */ (answer.status)]}: ${answer.reason}.`;
  if (brief) return "solved.";
  const rest = answer.nodes
    ? `${answer.iterations} iterations.`
    : `confidence ${answer.confidence.toFixed(3)}, best of ${answer.ways} paths.`;
  const words = `Solved in ${searchedMs(answer)} ms: ${answer.length_rad.toFixed(2)} rad, ${rest}`;
  return verdict ? `${words} Checked against the discs: ${verdictOf(verdict)}.` : words;
}

/** @param {HTMLElement} place @param {string} words @param {boolean} [bad] */
export function say(place, words, bad = false) {
  place.textContent = words;
  place.classList.toggle("bad", bad);
}

/** @param {Verdict} verdict */
export function verdictOf({ free, edges }) {
  return free ? "collision-free" : `collides on ${edges.filter((one) => !one).length} of ${edges.length} edges`;
}

/** @param {any} answer  Of POST /plan, or of trees, which take less. */
export function searchedMs({ timing_ms: took, search_ms: grew }) {
  return took ? Math.round(took.search + took.score) : grew.toFixed(1);
}
