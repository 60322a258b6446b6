// A way from start to goal: asked for, checked independently where the truth is known, and played.

/** @import {Configuration} from "./geometry.js" */
/** @import {Workbench} from "./main.js" */

import { ask } from "./api.js";
import { Player } from "./player.js";
import { planBody } from "./snippets.js";
import { byId } from "./svg.js";

const PLAY_MS = 4000;

export class Planner {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    /** @type {Configuration[]} */
    this.path = [];
    this.player = new Player("play", "along", PLAY_MS, () => bench.draw());
    this.asking = 0;
    this.told = byId("plan-told", HTMLElement);
    this.button = byId("plan", HTMLButtonElement);
    this.button.addEventListener("click", () => void this.plan());
  }

  /** What was planned does not fit any more. */
  forget() {
    this.asking += 1;
    if (this.path.length === 0 && this.told.textContent === "") return;
    this.path = [];
    this.player.load(false);
    this.say("");
  }

  async plan() {
    const { bench } = this;
    this.forget();
    const asking = this.asking;
    this.say(bench.about.plans ? "Looking for a way. The first one after an installation takes up to a minute." : "Asking.");
    this.button.disabled = true;
    try {
      const answer = await ask("plan", planBody(bench.state, bench.pictured()));
      if (asking !== this.asking) return;
      bench.messages.clear();
      this.path = answer.path;
      const words =
        answer.status === "solved"
          ? `Solved in ${Math.round(answer.timing_ms.search + answer.timing_ms.score)} ms: ${answer.length_rad.toFixed(2)} rad, ` +
            `confidence ${answer.confidence.toFixed(3)}, the surest of ${answer.ways} ways.`
          : `${answer.status === "refused" ? "Refused" : "Out of time"}: ${answer.reason}.`;
      this.say(words, answer.status !== "solved");
      this.player.load(this.path.length > 1);
      if (this.path.length > 1) {
        await this.check(asking, words);
        this.player.begin();
      }
    } catch (error) {
      this.say("");
      bench.messages.failed(error);
    } finally {
      this.button.disabled = false;
    }
  }

  /** Hold the way against the discs themselves. @param {number} asking @param {string} words */
  async check(asking, words) {
    const { state, about } = this.bench;
    if (!about.truth || state.picture) return;
    const discs = state.discs.map((disc) => [disc.x, disc.y, disc.r]);
    const model = state.model ? { model: state.model } : {};
    const { way } = await ask("workbench/truth", { ...model, discs, cells: 8, path: this.path });
    if (asking !== this.asking) return;
    const verdict = way.free ? "it is free" : `it collides on ${way.edges.filter((/** @type {boolean} */ free) => !free).length} of ${way.edges.length} pieces`;
    this.say(`${words} Checked against the discs: ${verdict}.`, !way.free);
  }

  /** @param {string} words @param {boolean} [bad] */
  say(words, bad = false) {
    this.told.textContent = words;
    this.told.classList.toggle("bad", bad);
  }
}
