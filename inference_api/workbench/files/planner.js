// A way from start to goal: asked for, checked independently where the truth is known, and played.

/** @import {Configuration} from "./geometry.js" */
/** @import {Workbench} from "./main.js" */

import { ask } from "./api.js";
import { planBody } from "./snippets.js";
import { byId } from "./svg.js";

const PLAY_MS = 4000;

export class Planner {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    /** @type {Configuration[]} */
    this.path = [];
    this.share = 0;
    this.playing = false;
    this.asking = 0;
    this.told = byId("plan-told", HTMLElement);
    this.button = byId("plan", HTMLButtonElement);
    this.play = byId("play", HTMLButtonElement);
    this.slider = byId("along", HTMLInputElement);
    this.button.addEventListener("click", () => void this.plan());
    this.play.addEventListener("click", () => (this.playing ? this.stop() : this.start()));
    this.slider.addEventListener("input", () => {
      this.share = Number(this.slider.value) / 1000;
      this.stop();
    });
  }

  /** What was planned does not fit any more. */
  forget() {
    this.asking += 1;
    if (this.path.length === 0 && this.told.textContent === "") return;
    this.stop();
    this.path = [];
    this.share = 0;
    this.say("");
    this.show();
  }

  async plan() {
    const { bench } = this;
    this.forget();
    const asking = this.asking;
    this.say(bench.about.plans ? "Looking for a way. The first one after an installation takes up to a minute." : "Asking.");
    this.button.disabled = true;
    try {
      const answer = await ask("plan", planBody(bench.state, await bench.pictured()));
      if (asking !== this.asking) return;
      bench.messages.clear();
      this.path = answer.path;
      const words =
        answer.status === "solved"
          ? `Solved in ${Math.round(answer.timing_ms.search + answer.timing_ms.score)} ms: ${answer.length_rad.toFixed(2)} rad, ` +
            `confidence ${answer.confidence.toFixed(3)}, the surest of ${answer.ways} ways.`
          : `${answer.status === "refused" ? "Refused" : "Out of time"}: ${answer.reason}.`;
      this.say(words, answer.status !== "solved");
      this.show();
      if (this.path.length > 1) {
        await this.check(asking, words);
        if (!matchMedia("(prefers-reduced-motion: reduce)").matches) this.start();
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

  start() {
    if (this.path.length < 2) return;
    this.playing = true;
    if (this.share >= 1) this.share = 0;
    this.show();
    let last = performance.now();
    const tick = (/** @type {number} */ now) => {
      if (!this.playing) return;
      this.share = Math.min(1, this.share + Math.max(0, now - last) / PLAY_MS);
      last = now;
      this.slider.value = String(Math.round(1000 * this.share));
      this.bench.draw();
      if (this.share >= 1) this.stop();
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  stop() {
    this.playing = false;
    this.show();
  }

  show() {
    const none = this.path.length < 2;
    this.play.disabled = none;
    this.slider.disabled = none;
    this.slider.value = String(Math.round(1000 * this.share));
    this.play.textContent = this.playing ? "Pause" : "Play";
    this.bench.draw();
  }

  /** @param {string} words @param {boolean} [bad] */
  say(words, bad = false) {
    this.told.textContent = words;
    this.told.classList.toggle("bad", bad);
  }
}
