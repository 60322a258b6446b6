// Samples and truth for what is shown, asked for again whenever it changes, one question at a time.

/** @import {Ground} from "./torus-view.js" */

import { ApiAway, ApiProblem, ask } from "./api.js";

/** How long it took from an interaction to its samples, for those who measure the page. */
export const MEASURE = "interaction-to-samples";

/**
 * @typedef {object} Asked  Made anew for every round.
 * @property {object} sample  The body of POST /sample.
 * @property {((samples: number[][]) => object) | null} truth  The body for the truth; null where it is not known.
 * @property {(() => object) | null} belief  The body of POST /validity; null where it is not shown.
 *
 * @typedef {object} Heard
 * @property {(answer: any, tookMs: number) => void} samples
 * @property {(answer: any) => void} truth
 * @property {(answer: any) => void} belief
 * @property {(error: unknown) => void} failed
 * @property {(busy: boolean) => void} busy  Whether answers are waited for.
 */

export class Live {
  /**
   * @param {() => Promise<Asked>} asked
   * @param {Heard} heard
   */
  constructor(asked, heard) {
    this.asked = asked;
    this.heard = heard;
    this.running = false;
    /** When the oldest change was made that no samples are there for; null for none. @type {number | null} */
    this.since = null;
  }

  /** Something has changed. */
  changed() {
    this.since ??= performance.now();
    if (!this.running) void this.run();
  }

  async run() {
    this.running = true;
    this.heard.busy(true);
    try {
      while (this.since !== null) await this.once();
    } finally {
      this.running = false;
      this.heard.busy(false);
    }
  }

  async once() {
    const since = this.since ?? performance.now();
    this.since = null;
    try {
      const asked = await this.asked();
      const answer = await ask("sample", asked.sample);
      this.heard.samples(answer, performance.now() - since);
      performance.measure(MEASURE, { start: since });
      if (asked.truth) this.heard.truth(await ask("workbench/truth", asked.truth(answer.samples)));
      if (asked.belief && this.since === null) this.heard.belief(await ask("validity", asked.belief()));
    } catch (error) {
      this.heard.failed(error);
      if (error instanceof ApiAway) this.since = null;
      else if (error instanceof ApiProblem && error.retryS > 0) {
        await new Promise((done) => setTimeout(done, 1000 * error.retryS));
        this.since ??= performance.now();
      }
    }
  }
}

/**
 * The truth's answer as ground.
 * @param {{cells: number, free: string}} answer
 * @returns {Ground}
 */
export function trueGround(answer) {
  const bits = Uint8Array.from(atob(answer.free), (letter) => letter.charCodeAt(0));
  return {
    cells: answer.cells,
    level: (first, second) => {
      const at = first * answer.cells + second;
      return (bits[at >> 3] >> (7 - (at & 7))) & 1 ? 0 : 3;
    },
  };
}

/**
 * The model's confidence on a grid as ground.
 * @param {number[]} confidence
 * @param {number} cells
 * @returns {Ground}
 */
export function believedGround(confidence, cells) {
  return {
    cells,
    level: (first, second) => {
      const value = confidence[first * cells + second];
      return value >= 0.9 ? 0 : value >= 0.5 ? 1 : value >= 0.1 ? 2 : 3;
    },
  };
}
