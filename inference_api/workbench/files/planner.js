// A way from start to goal: asked for, checked independently where the truth is known, and played.

/** @import {Workbench} from "./main.js" */
/** @import {Side} from "./side.js" */

import { ask } from "./api.js";
import { degrees } from "./geometry.js";
import { Player } from "./player.js";
import { planBody } from "./snippets.js";
import { buttonOf, byId } from "./svg.js";

const PLAY_MS = 4000;
export const LOOKING = "Looking for a way. The first one after an installation takes up to a minute.";

/**
 * @typedef {object} Planned
 * @property {any} answer  Of POST /plan.
 * @property {{free: boolean, edges: boolean[]} | null} way  What is true of it; null where nobody knows.
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
    this.tellDoubt();
  }

  /** Ask one model after the other, so that none waits for another's search. */
  async plan() {
    const { bench } = this;
    this.forget();
    const asking = this.asking;
    const sides = bench.sides();
    say(this.told, bench.about.plans ? LOOKING : "Asking.");
    this.button.disabled = true;
    try {
      for (const side of sides) {
        const answer = await ask("plan", { ...planBody(bench.state, bench.pictured()), ...side.model });
        if (asking !== this.asking) return;
        side.planned = { answer, way: null };
        this.tell(sides);
        side.planned.way = await this.check(side);
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

  /** Hold the way against the discs themselves. @param {Side} side */
  async check(side) {
    const { state, about } = this.bench;
    if (!about.truth || state.picture || side.way.length < 2) return null;
    const discs = state.discs.map((disc) => [disc.x, disc.y, disc.r]);
    return (await ask("workbench/truth", { ...side.model, discs, cells: 8, path: side.way })).way;
  }

  /** @param {Side[]} sides */
  tell(sides) {
    const planned = sides.filter((side) => side.planned);
    const two = sides.length > 1;
    const words = planned.map((side) => (two ? `${side.title}: ` : "") + wordsOf(/** @type {Planned} */ (side.planned), two));
    say(this.told, words.join(" "), planned.some(({ planned }) => planned?.answer.status !== "solved" || planned.way?.free === false));
    this.tellDoubt();
    this.bench.readout.show();
    this.bench.draw();
  }

  /** How sure the first model's way is, piece by piece, and where least. */
  tellDoubt() {
    const { first } = this.bench;
    const { edges } = first.doubt;
    const least = first.planned?.answer.least_sure;
    const told = [];
    if (least) {
      const angles = least.configuration.map(degrees).join(", ");
      told.push(`Least sure, ${least.confidence.toFixed(3)}, after ${Math.round(100 * least.along)} % of it: ${angles}.`);
    }
    if (edges.length) told.push(`On its pieces: ${edges.map((one) => one.toFixed(3)).join(", ")}.`);
    byId("plan-doubt").textContent = told.join(" ");
  }
}

/** @param {Planned} planned @param {boolean} brief  Where a table tells the rest. */
function wordsOf({ answer, way }, brief) {
  if (answer.status !== "solved") return `${answer.status === "refused" ? "Refused" : "Out of time"}: ${answer.reason}.`;
  if (brief) return "solved.";
  const words =
    `Solved in ${searchedMs(answer)} ms: ${answer.length_rad.toFixed(2)} rad, ` +
    `confidence ${answer.confidence.toFixed(3)}, the surest of ${answer.ways} ways.`;
  if (!way) return words;
  return `${words} Checked against the discs: ${verdictOf(way)}.`;
}

/** @param {HTMLElement} place @param {string} words @param {boolean} [bad] */
export function say(place, words, bad = false) {
  place.textContent = words;
  place.classList.toggle("bad", bad);
}

/** @param {{free: boolean, edges: boolean[]}} way */
export function verdictOf({ free, edges }) {
  return free ? "it is free" : `it collides on ${edges.filter((one) => !one).length} of ${edges.length} pieces`;
}

/** @param {any} answer  Of POST /plan. */
export function searchedMs({ timing_ms: took }) {
  return Math.round(took.search + took.score);
}
