// A path from start to goal: planned, checked where the ground truth is known, and played.

/** @import {Workbench} from "./main.js" */
/** @import {Configuration} from "./geometry.js" */

import { ask } from "./api.js";
import { degrees } from "./geometry.js";
import { buttonOf, byId, inputOf } from "./svg.js";

const PLAY_MS = 4000;
const LOOKING = "Searching for a path. The first one after an installation takes up to a minute.";

export class Planner {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    /** The answer of POST /plan. @type {any} */
    this.answer = null;
    this.round = 0;
    this.share = 0;
    this.playing = false;
    this.button = buttonOf("plan");
    this.playButton = buttonOf("play");
    this.slider = inputOf("along");
    this.button.addEventListener("click", () => void this.plan());
    this.playButton.addEventListener("click", () => (this.playing ? this.stop() : this.play()));
    this.slider.addEventListener("input", () => {
      this.share = Number(this.slider.value) / 1000;
      this.stop();
    });
  }

  /** Empty where there is none. @type {Configuration[]} */
  get path() {
    return this.answer?.path ?? [];
  }

  /** The lowest confidence on each edge. @type {number[]} */
  get edges() {
    return this.answer?.edges ?? [];
  }

  /** Where the confidence is lowest, unless it is high there, too. @type {Configuration | null} */
  get least() {
    const least = this.answer?.least_sure;
    return least?.confidence < 0.99 ? least.configuration : null;
  }

  /** The plan belongs to another problem. */
  forget() {
    this.round += 1;
    this.answer = null;
    this.share = 0;
    this.stop();
    say("");
    byId("plan-confidence").textContent = "";
  }

  async plan() {
    const { bench } = this;
    this.forget();
    const { round } = this;
    say(LOOKING);
    this.button.disabled = true;
    try {
      const body = await bench.body("plan");
      if (!body) return say("There is no picture to plan in.", true);
      const answer = await ask("plan", body);
      if (round !== this.round) return;
      this.answer = answer;
      this.report(null);
      if (this.path.length > 1) {
        if (bench.knowsTruth) {
          const { path_free: free } = await ask("workbench/truth", { ...bench.scene(), cells: 8, path: this.path });
          if (round !== this.round) return;
          this.report(free);
        }
        if (!matchMedia("(prefers-reduced-motion: reduce)").matches) this.play();
      }
      bench.messages.clear();
    } catch (error) {
      if (!this.answer) say("");
      bench.messages.failed(error);
    } finally {
      this.button.disabled = false;
      this.show();
    }
  }

  /** @param {boolean[] | null} free  Of each edge, by the ground truth. */
  report(free) {
    const { status, reason, timing_ms: took, length_rad: length, confidence, ways } = this.answer;
    const hits = free?.filter((one) => !one).length ?? 0;
    const verdict = hits ? `collides on ${hits} of ${free?.length} edges` : "collision-free";
    if (status !== "solved") say(`${status === "timeout" ? "Timed out" : "Refused"}: ${reason}.`, true);
    else {
      const words = `Solved in ${Math.round(took.search + took.score)} ms: ${length.toFixed(2)} rad, `;
      const checked = free ? ` Checked against the discs: ${verdict}.` : "";
      say(`${words}confidence ${confidence.toFixed(3)}, best of ${ways} paths.${checked}`, hits > 0);
    }
    const { least_sure: least } = this.answer;
    const lines = [];
    if (least) {
      const angles = least.configuration.map(degrees).join(", ");
      lines.push(`Lowest confidence ${least.confidence.toFixed(3)} after ${Math.round(100 * least.along)} % of the path: ${angles}.`);
    }
    if (this.edges.length) lines.push(`Per edge: ${this.edges.map((one) => one.toFixed(3)).join(", ")}.`);
    byId("plan-confidence").textContent = lines.join(" ");
    this.show();
  }

  play() {
    this.playing = true;
    if (this.share >= 1) this.share = 0;
    let last = performance.now();
    const tick = (/** @type {number} */ now) => {
      if (!this.playing) return;
      this.share = Math.min(1, this.share + Math.max(0, now - last) / PLAY_MS);
      last = now;
      if (this.share >= 1) return this.stop();
      this.show();
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
    this.show();
  }

  stop() {
    this.playing = false;
    this.show();
  }

  show() {
    this.playButton.disabled = this.slider.disabled = this.path.length < 2;
    this.slider.value = String(Math.round(1000 * this.share));
    this.playButton.textContent = this.playing ? "Pause" : "Play";
    this.bench.draw();
  }
}

/** @param {string} words @param {boolean} [bad] */
function say(words, bad = false) {
  const place = byId("plan-status");
  place.textContent = words;
  place.classList.toggle("bad", bad);
}
