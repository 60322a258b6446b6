// Samples, ground truth and prediction of what is shown, requested again whenever it changes.

/** @import {Ground} from "./torus-view.js" */
/** @import {Workbench} from "./main.js" */

import { ApiAway, ApiProblem, ask } from "./api.js";

/** The time from an interaction to its samples, for those who measure the page. */
export const MEASURE = "interaction-to-samples";
const PREDICTION_CELLS = 64;
const TRUTH_CELLS = 120;

export class Live {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    /** When the oldest change was made that has no samples yet. @type {number | null} */
    this.since = null;
    this.sampling = this.checking = false;
    /** The last request for samples, and its answer. @type {{body: any, samples: number[][]} | null} */
    this.last = null;
  }

  changed() {
    this.since ??= performance.now();
    if (!this.sampling) void this.sample();
  }

  busy() {
    this.bench.map.setAttribute("aria-busy", String(this.sampling || this.checking));
  }

  /** One request at a time; changes in between are answered together. */
  async sample() {
    this.sampling = true;
    this.busy();
    while (this.since !== null) {
      const since = this.since;
      this.since = null;
      try {
        const body = await this.bench.body("sample");
        if (!body) break;
        const answer = await ask("sample", body);
        this.bench.sampled(answer, performance.now() - since);
        performance.measure(MEASURE, { start: since });
        this.last = { body, samples: answer.samples };
        if (!this.checking) void this.check();
      } catch (error) {
        this.bench.messages.failed(error);
        if (error instanceof ApiAway) this.since = null;
        else if (error instanceof ApiProblem && error.retryS > 0) {
          await new Promise((done) => setTimeout(done, 1000 * error.retryS));
          this.since ??= performance.now();
        }
      }
    }
    this.sampling = false;
    this.busy();
  }

  /** Ground truth or prediction for the last samples, which do not wait for it. */
  async check() {
    const { bench } = this;
    this.checking = true;
    try {
      for (let done = null; this.last !== done; ) {
        const last = (done = this.last);
        if (!last) break;
        const { ground, start } = bench.state;
        if (bench.knowsTruth) {
          const at = start.length > 2 ? { at: start } : {};
          const body = { ...bench.scene(), ...at, cells: TRUTH_CELLS, configurations: last.samples };
          bench.checked(await ask("workbench/truth", body), last.samples);
        }
        if (ground === "prediction") {
          const { image, model } = last.body;
          const body = { image, configurations: this.grid(), ...(model ? { model } : {}) };
          bench.predicted(predictedGround((await ask("validity", body)).confidence));
        }
      }
    } catch (error) {
      bench.messages.failed(error);
    }
    this.checking = false;
    this.busy();
  }

  /** Cells over the first two joints; the others stand as at the start. */
  grid() {
    const { low, high } = /** @type {import("./geometry.js").Robot} */ (this.bench.robot);
    const at = (/** @type {number} */ joint, /** @type {number} */ cell) =>
      Number((low[joint] + ((cell + 0.5) / PREDICTION_CELLS) * (high[joint] - low[joint])).toFixed(4));
    const rest = this.bench.state.start.slice(2);
    return Array.from({ length: PREDICTION_CELLS ** 2 }, (_, cell) => [
      at(0, Math.floor(cell / PREDICTION_CELLS)), at(1, cell % PREDICTION_CELLS), ...rest,
    ]);
  }
}

/** @param {{cells: number, free: string}} answer @returns {Ground} */
export function trueGround({ cells, free }) {
  const bits = Uint8Array.from(atob(free), (letter) => letter.charCodeAt(0));
  const isFree = (/** @type {number} */ at) => (bits[at >> 3] >> (7 - (at & 7))) & 1;
  return { cells, level: (first, second) => (isFree(first * cells + second) ? 0 : 3) };
}

/** @param {number[]} confidence @returns {Ground} */
function predictedGround(confidence) {
  const level = (/** @type {number} */ value) => (value >= 0.9 ? 0 : value >= 0.5 ? 1 : value >= 0.1 ? 2 : 3);
  return { cells: PREDICTION_CELLS, level: (first, second) => level(confidence[first * PREDICTION_CELLS + second]) };
}
