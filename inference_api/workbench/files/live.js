// Samples and truth for what is shown, requested again whenever it changes, one request at a time.

/** @import {Ground} from "./torus-view.js" */

import { ApiAway, ApiProblem, ask } from "./api.js";

/** How long it took from an interaction to its samples, for those who measure the page. */
export const MEASURE = "interaction-to-samples";

/**
 * @typedef {object} Requests  Made again for every round.
 * @property {object} sample  The body of POST /sample.
 * @property {((samples: number[][]) => object) | null} truth  The body for the truth; null where it is not known.
 * @property {(() => object) | null} prediction  The body of POST /validity; null where it is not shown.
 *
 * @typedef {object} Handlers
 * @property {(answer: any, tookMs: number) => void} samples
 * @property {(answer: any, samples: number[][]) => void} truth  Of these samples; others may be shown by now.
 * @property {(answer: any) => void} prediction
 * @property {(error: unknown) => void} failed
 * @property {(busy: boolean) => void} busy  Whether answers are waited for.
 */

export class Live {
  /**
   * @param {() => Promise<Requests>} makeRequests
   * @param {Handlers} handlers
   */
  constructor(makeRequests, handlers) {
    this.makeRequests = makeRequests;
    this.handlers = handlers;
    /** When the oldest change was made that no samples are there for; null for none. @type {number | null} */
    this.since = null;
    /** What is requested beside the samples, which do not wait for it. @type {(() => Promise<void>) | null} */
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
    this.handlers.busy(true);
    try {
      await loop();
    } catch (error) {
      this.handlers.failed(error);
    } finally {
      this.running[which] = false;
      this.handlers.busy(this.running.samples || this.running.beside);
    }
  }

  async once() {
    const since = this.since ?? performance.now();
    this.since = null;
    try {
      const requests = await this.makeRequests();
      const answer = await ask("sample", requests.sample);
      this.handlers.samples(answer, performance.now() - since);
      performance.measure(MEASURE, { start: since });
      this.askBeside(requests, answer.samples);
    } catch (error) {
      this.handlers.failed(error);
      if (error instanceof ApiAway) this.since = null;
      else if (error instanceof ApiProblem && error.retryS > 0) {
        await new Promise((done) => setTimeout(done, 1000 * error.retryS));
        this.since ??= performance.now();
      }
    }
  }

  /** The truth and the prediction of the latest samples, one question at a time. @param {Requests} requests @param {number[][]} samples */
  askBeside(requests, samples) {
    this.beside = async () => {
      if (requests.truth) this.handlers.truth(await ask("workbench/truth", requests.truth(samples)), samples);
      if (requests.prediction && this.since === null) this.handlers.prediction(await ask("validity", requests.prediction()));
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
