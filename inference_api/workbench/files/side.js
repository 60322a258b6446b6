// A model's part of the page: its requests, its map of the joint space, and what it has answered.

/** @import {Configuration, Robot} from "./geometry.js" */
/** @import {Workbench} from "./main.js" */
/** @import {Planned} from "./planner.js" */

import { Live, predictedGround, trueGround } from "./live.js";
import { byId } from "./svg.js";
import { TorusView } from "./torus-view.js";

const PREDICTION_CELLS = 64;
const TRUTH_CELLS = 120;

export class Side {
  /**
   * @param {Workbench} bench
   * @param {string} id  Of its map.
   * @param {"model" | "beside"} part  Of the state, which names the model.
   */
  constructor(bench, id, part) {
    this.bench = bench;
    this.map = byId(id, SVGSVGElement);
    this.part = part;
    /** @type {TorusView | null} */
    this.torus = null;
    /** @type {{samples: number[][], confidence: number[] | null, free: boolean[] | null, ground: any}} */
    this.shown = { samples: [], confidence: null, free: null, ground: null };
    /** The last answers. @type {any} */
    this.answer = null;
    /** @type {any} */
    this.truth = null;
    /** @type {Planned | null} */
    this.planned = null;
    this.failing = false;
    this.live = new Live(() => this.requests(), {
      samples: (answer, tookMs) => this.sampled(answer, tookMs),
      truth: (answer, samples) => this.checked(answer, samples),
      prediction: (answer) => this.predicted(answer),
      failed: (error) => {
        this.failing = true;
        bench.messages.failed(error);
      },
      busy: (busy) => this.map.setAttribute("aria-busy", String(busy)),
    });
  }

  /** The model as requests name it; nothing for the default one. */
  get model() {
    const name = this.bench.state[this.part];
    return name ? { model: name } : {};
  }

  /** What it is called on the page. */
  get title() {
    const { name, version } = this.answer?.model ?? {};
    return name ? `${name}${version ? `/${version}` : ""}` : this.bench.state[this.part] || "default";
  }

  /** Its path; empty where there is none. */
  get path() {
    /** @type {Configuration[]} */
    const path = this.planned?.answer.path ?? [];
    return path;
  }

  /** Confidence of its path: on each edge, and where lowest if below 0.99. */
  get uncertainty() {
    const answer = this.planned?.answer;
    /** @type {number[]} */
    const edges = answer?.edges ?? [];
    const least = answer?.least_sure;
    return { edges, least: least?.confidence < 0.99 ? least.configuration : null };
  }

  /** Make its map again. @param {Robot} robot */
  make(robot) {
    const { bench } = this;
    this.torus = new TorusView(this.map, robot, {
      end: (end, configuration) => bench.moveEnd(end, configuration),
      click: (first, second) => bench.controls.clicked(first, second),
      peek: (first, second) => bench.peeked(first, second),
    });
  }

  /** Ask again; what was answered is of another model where that has changed. @param {boolean} another */
  changed(another) {
    if (another) [this.answer, this.truth, this.failing] = [null, null, false];
    this.live.changed();
  }

  /** The requests of a round. */
  async requests() {
    const { model } = this;
    const { state, about, robot } = this.bench;
    const sample = await this.body("sample");
    return {
      sample,
      truth: about.truth && !state.picture
        ? (/** @type {number[][]} */ configurations) => ({
            ...model, ...this.bench.discs(), cells: TRUTH_CELLS, configurations,
            ...(robot && robot.links.length > 2 ? { at: state.start } : {}),
          })
        : null,
      prediction: state.ground === "prediction" ? () => ({ ...model, image: sample.image, configurations: this.grid() }) : null,
    };
  }

  /** The request for the samples or the path that are shown. @param {"sample" | "plan"} page */
  async body(page) {
    const { n, seed, confidence, start, goal, planSeed, limit, paths, minConfidence } = this.bench.state;
    const image = await this.bench.pictured();
    const fields =
      page === "sample"
        ? { n, seed, ...minConfidenceField(confidence) }
        : { start, goal, seed: planSeed, time_limit_s: limit, ways: paths, ...minConfidenceField(minConfidence) };
    return { image, ...fields, ...this.model };
  }

  grid() {
    const { low, high } = /** @type {Robot} */ (this.bench.robot);
    const at = (/** @type {number} */ joint, /** @type {number} */ cell) =>
      Number((low[joint] + ((cell + 0.5) / PREDICTION_CELLS) * (high[joint] - low[joint])).toFixed(4));
    const rest = this.bench.state.start.slice(2);
    return Array.from({ length: PREDICTION_CELLS ** 2 }, (_, cell) => [
      at(0, Math.floor(cell / PREDICTION_CELLS)), at(1, cell % PREDICTION_CELLS), ...rest,
    ]);
  }

  /** @param {any} answer @param {number} tookMs */
  sampled(answer, tookMs) {
    const { bench } = this;
    const { ground, picture } = bench.state;
    const kept = ground === "prediction" || (ground === "truth" && bench.about.truth && !picture);
    this.shown = { samples: answer.samples, confidence: answer.confidence, free: null, ground: kept ? this.shown.ground : null };
    this.torus?.show(this.shown);
    this.answer = answer;
    this.failing = false;
    if (bench.sides().every((side) => !side.failing)) bench.messages.clear();
    if (this.part === "model") bench.messages.here(`${answer.samples.length} samples in ${Math.round(tookMs)} ms`);
    bench.readout.show();
  }

  /** @param {any} answer @param {number[][]} samples */
  checked(answer, samples) {
    if (samples === this.shown.samples) this.shown.free = answer.sample_free;
    if (this.bench.state.ground === "truth") this.shown.ground = trueGround(answer);
    this.torus?.show(this.shown);
    this.truth = answer;
    this.bench.readout.show();
  }

  /** @param {any} answer */
  predicted(answer) {
    if (this.bench.state.ground !== "prediction") return;
    this.shown.ground = predictedGround(answer.confidence, PREDICTION_CELLS);
    this.torus?.show(this.shown);
  }
}

/** The minimum confidence as a field; none for the model default. @param {number | null} confidence */
export const minConfidenceField = (confidence) => (confidence === null ? {} : { min_confidence: confidence });
