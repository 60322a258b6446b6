// Samples and truth for what is shown, asked for again whenever it changes, one question at a time.

/** @import {Ground} from "./torus-view.js" */

import { ApiAway, ApiProblem, ask } from "./api.js";

/** How long it took from an interaction to its samples, for those who measure the page. */
export const MEASURE = "interaction-to-samples";

/**
 * @typedef {object} Asked  Made again for every round.
 * @property {object} sample  The body of POST /sample.
 * @property {((samples: number[][]) => object) | null} truth  The body for the truth; null where it is not known.
 * @property {(() => object) | null} prediction  The body of POST /validity; null where it is not shown.
 *
 * @typedef {object} Heard
 * @property {(answer: any, tookMs: number) => void} samples
 * @property {(answer: any, samples: number[][]) => void} truth  Of these samples; others may be shown by now.
 * @property {(answer: any) => void} prediction
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
    /** When the oldest change was made that no samples are there for; null for none. @type {number | null} */
    this.since = null;
    /** What is asked beside the samples, which do not wait for it. @type {(() => Promise<void>) | null} */
    this.beside = null;
    this.running = { samples: false, beside: false };
  }

  /** Something has changed. */
  changed() {
    this.since ??= performance.now();
    void this.run("samples", async () => {
      while (this.since !== null) await this.once();
    });
  }

  /** Run a loop unless it runs. @param {"samples" | "beside"} which @param {() => Promise<void>} loop */
  async run(which, loop) {
    if (this.running[which]) return;
    this.running[which] = true;
    this.heard.busy(true);
    try {
      await loop();
    } catch (error) {
      this.heard.failed(error);
    } finally {
      this.running[which] = false;
      this.heard.busy(this.running.samples || this.running.beside);
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
      this.askBeside(asked, answer.samples);
    } catch (error) {
      this.heard.failed(error);
      if (error instanceof ApiAway) this.since = null;
      else if (error instanceof ApiProblem && error.retryS > 0) {
        await new Promise((done) => setTimeout(done, 1000 * error.retryS));
        this.since ??= performance.now();
      }
    }
  }

  /** The truth and the prediction of the latest samples, one question at a time. @param {Asked} asked @param {number[][]} samples */
  askBeside(asked, samples) {
    this.beside = async () => {
      if (asked.truth) this.heard.truth(await ask("workbench/truth", asked.truth(samples)), samples);
      if (asked.prediction && this.since === null) this.heard.prediction(await ask("validity", asked.prediction()));
    };
    void this.run("beside", async () => {
      while (this.beside) {
        const next = this.beside;
        this.beside = null;
        const began = performance.now();
        await next();
        // As long again, so that samples come first on a machine that has much to do.
        await new Promise((done) => setTimeout(done, this.beside ? Math.min(200, performance.now() - began) : 0));
      }
    });
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
export function predictedGround(confidence, cells) {
  return {
    cells,
    level: (first, second) => {
      const value = confidence[first * cells + second];
      return value >= 0.9 ? 0 : value >= 0.5 ? 1 : value >= 0.1 ? 2 : 3;
    },
  };
}
