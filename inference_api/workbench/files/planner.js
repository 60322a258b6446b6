// A way from start to goal: asked for, checked independently where the truth is known, and played.

/** @import {Workbench} from "./main.js" */
/** @import {Side} from "./side.js" */

import { ask } from "./api.js";
import { Player } from "./player.js";
import { planBody } from "./snippets.js";
import { byId } from "./svg.js";

const PLAY_MS = 4000;

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
    this.told = byId("plan-told", HTMLElement);
    this.button = byId("plan", HTMLButtonElement);
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
    this.say("");
  }

  /** Ask one model after the other, so that none waits for another's search. */
  async plan() {
    const { bench } = this;
    this.forget();
    const asking = this.asking;
    const sides = bench.sides();
    this.say(bench.about.plans ? "Looking for a way. The first one after an installation takes up to a minute." : "Asking.");
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
      if (!bench.first.planned) this.say("");
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
    this.say(words.join(" "), planned.some(({ planned }) => planned?.answer.status !== "solved" || planned.way?.free === false));
    this.bench.readout.show();
    this.bench.draw();
  }

  /** @param {string} words @param {boolean} [bad] */
  say(words, bad = false) {
    this.told.textContent = words;
    this.told.classList.toggle("bad", bad);
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
  const hit = way.edges.filter((free) => !free).length;
  return `${words} Checked against the discs: ${way.free ? "it is free" : `it collides on ${hit} of ${way.edges.length} pieces`}.`;
}

/** @param {any} answer  Of POST /plan. */
export function searchedMs({ timing_ms: took }) {
  return Math.round(took.search + took.score);
}
