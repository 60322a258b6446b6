// The page: its state, and how its parts interact.

/** @import {Camera, Configuration, End, Robot} from "./geometry.js" */
/** @import {State} from "./state.js" */
/** @import {Ground} from "./torus-view.js" */

/**
 * @typedef {{reference: string, name: string, aliases: string[], default: boolean, world: any, joint_space: any}} Listed
 */

import { ask } from "./api.js";
import { Controls } from "./controls.js";
import { listenToCopies } from "./export.js";
import { along, bound } from "./geometry.js";
import { Live, trueGround } from "./live.js";
import { Messages } from "./messages.js";
import { Planner } from "./plan.js";
import { showFigures } from "./readout.js";
import { SceneView } from "./scene-view.js";
import { fromHash, toHash } from "./state.js";
import { byId } from "./svg.js";
import { TorusView } from "./torus-view.js";

const GHOSTS = 14;
const SCENE = ["discs", "picture", "start", "goal", "model"];
const PLAN = ["planSeed", "limit", "paths", "minConfidence"];
const SAMPLES = ["n", "seed", "confidence", "ground"];

export class Workbench {
  constructor() {
    /** @type {State} */
    this.state = fromHash(location.hash);
    /** Whether the server draws scenes and knows their ground truth. */
    this.truth = false;
    /** @type {Listed[]} */
    this.models = [];
    /** @type {Robot | null} */
    this.robot = null;
    /** The selected disc; -1 for none. */
    this.chosen = -1;
    /** Where the pointer is in the joint space. @type {Configuration | null} */
    this.peek = null;
    /** The picture of these discs. @type {{of: object | null, image: Promise<string>}} */
    this.drawn = { of: null, image: Promise.resolve("") };
    /** @type {{samples: number[][], confidence: number[] | null, free: boolean[] | null, ground: Ground | null}} */
    this.shown = { samples: [], confidence: null, free: null, ground: null };
    /** The last answers of /sample and of the ground truth. @type {any} */
    this.answer = null;
    /** @type {any} */
    this.checks = null;
    /** @type {number | undefined} */
    this.frame = undefined;
    this.map = byId("torus", SVGSVGElement);
    this.messages = new Messages(() => void this.begin());
    this.live = new Live(this);
    this.planner = new Planner(this);
    this.controls = new Controls(this);
    listenToCopies(this);
    addEventListener("hashchange", () => this.opened());
  }

  /** Ask what the server has, then show it. */
  async begin() {
    try {
      const [about, listed] = await Promise.all([ask("workbench/about"), ask("models")]);
      this.truth = about.truth;
      this.models = listed.models.filter((/** @type {Listed} */ model) => model.world?.kind === "planar");
      this.controls.ready();
      this.choose(this.state.model);
    } catch (error) {
      this.messages.failed(error);
    }
  }

  get knowsTruth() {
    return this.truth && !this.state.picture;
  }

  /** The scene as the routes of this page take it. */
  scene() {
    const { model, discs } = this.state;
    return { ...(model ? { model } : {}), discs: discs.map(({ x, y, r }) => [x, y, r]) };
  }

  /** The base64 PNG that is sent; null where there is none. */
  async picture() {
    const { picture, discs } = this.state;
    if (picture) return picture;
    if (!this.truth) return null;
    if (this.drawn.of !== discs) {
      const image = ask("workbench/picture", this.scene()).then((answer) => answer.image);
      this.drawn = { of: discs, image };
      image.catch(() => (this.drawn.of = null));
    }
    return this.drawn.image;
  }

  /** The request for the samples or the path that are shown. @param {"sample" | "plan"} endpoint */
  async body(endpoint) {
    const { n, seed, confidence, start, goal, planSeed, limit, paths, minConfidence, model } = this.state;
    const image = await this.picture();
    this.controls.showPicture(image);
    if (!image) return null;
    const least = endpoint === "sample" ? confidence : minConfidence;
    const fields = endpoint === "sample" ? { n, seed } : { start, goal, seed: planSeed, time_limit_s: limit, ways: paths };
    return { image, ...fields, ...(least === null ? {} : { min_confidence: least }), ...(model ? { model } : {}) };
  }

  /** Show a model's robot. @param {string} reference */
  choose(reference) {
    const wanted = this.models.find((model) => (reference ? isNamed(model, reference) : model.default)) ?? this.models[0];
    if (!wanted) return;
    const { robot, camera } = wanted.world;
    const { lower, upper, periodic } = wanted.joint_space;
    const links = robot.link_lengths_m;
    this.robot = {
      links,
      halfWidth: robot.half_width_m,
      low: lower ?? links.map(() => -Math.PI),
      high: upper ?? links.map(() => Math.PI),
      circle: periodic ?? links.map(() => true),
    };
    /** @type {Camera} */
    this.camera = { left: camera.x_min_m, right: camera.x_max_m, bottom: camera.y_min_m, top: camera.y_max_m };
    this.drawn.of = this.answer = this.checks = null;
    this.sceneView = new SceneView(byId("scene", SVGSVGElement), this.robot, this.camera, {
      disc: (at, disc, byKey) => this.controls.moveDisc(at, disc, byKey),
      choose: (at) => this.chooseDisc(at),
      remove: (at) => this.controls.removeDisc(at),
      end: (end, configuration) => this.moveEnd(end, configuration),
    });
    this.torusView = new TorusView(this.map, this.robot, {
      end: (end, configuration) => this.moveEnd(end, configuration),
      click: (first, second) => this.controls.clicked(first, second),
      peek: (first, second) => {
        this.peek = first === null ? null : [first, second, ...this.state.start.slice(2)];
        this.draw();
      },
    });
    const { start, goal } = this.state;
    this.change({ model: reference, start: bound(this.robot, start), goal: bound(this.robot, goal) });
  }

  /** The address was changed by hand or by a link. */
  opened() {
    if (location.hash === toHash(this.state)) return;
    this.state = fromHash(location.hash);
    this.choose(this.state.model);
  }

  /** @param {Partial<State>} changes */
  change(changes) {
    const has = (/** @type {string[]} */ names) => names.some((name) => name in changes);
    this.state = { ...this.state, ...changes };
    if (has(SCENE) || has(PLAN)) this.planner.forget();
    this.draw();
    if (has(SCENE) || has(SAMPLES)) this.live.changed();
    this.remember();
  }

  /** Keep the state in the address; browsers limit how often that is changed. */
  remember() {
    clearTimeout(this.later);
    this.later = setTimeout(() => history.replaceState(null, "", toHash(this.state)), 200);
  }

  /** @param {End} end @param {Configuration} configuration */
  moveEnd(end, configuration) {
    if (!this.robot) return;
    this.planner.forget();
    this.state = { ...this.state, [end]: bound(this.robot, configuration) };
    this.draw();
    this.remember();
    // The map shows a slice of the joint space at the start's further joints.
    if (this.robot.links.length > 2) this.live.changed();
  }

  /** @param {number} at */
  chooseDisc(at) {
    this.chosen = at;
    this.draw();
  }

  /** @param {any} answer @param {number} tookMs */
  sampled(answer, tookMs) {
    const keepsGround = this.state.ground === "prediction" || (this.state.ground === "truth" && this.knowsTruth);
    const { samples, confidence } = answer;
    this.shown = { samples, confidence, free: null, ground: keepsGround ? this.shown.ground : null };
    this.answer = answer;
    this.messages.clear();
    this.messages.here(`${samples.length} samples in ${Math.round(tookMs)} ms`);
    this.showAnswers();
  }

  /** @param {any} checks @param {number[][]} samples  That were checked; others may be shown by now. */
  checked(checks, samples) {
    if (samples === this.shown.samples) this.shown.free = checks.sample_free;
    if (this.state.ground === "truth") this.shown.ground = trueGround(checks);
    this.checks = checks;
    this.showAnswers();
  }

  /** @param {Ground} ground */
  predicted(ground) {
    if (this.state.ground === "prediction") this.shown.ground = ground;
    this.showAnswers();
  }

  showAnswers() {
    this.torusView?.show(this.shown);
    showFigures(this);
  }

  /** Draw at the next frame; several changes before it are drawn together. */
  draw() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      this.drawNow();
    });
  }

  drawNow() {
    const { robot, state, planner } = this;
    if (!robot || !this.sceneView || !this.torusView) return;
    const { path, edges, least } = planner;
    const share = (/** @type {number} */ at) => along(robot, path, at);
    const moving = path.length ? share(planner.share) : null;
    const ghost = path.length ? Array.from({ length: GHOSTS }, (_, at) => share((at + 1) / (GHOSTS + 1))) : [];
    const { discs, start, goal, picture } = state;
    this.sceneView.show({ discs, chosen: this.chosen, start, goal, ghost, moving, least, peek: this.peek, picture });
    this.torusView.showEnds({ start, goal, path, moving, edges, least });
    this.controls.show();
  }
}

/** @param {Listed} model @param {string} reference */
const isNamed = (model, reference) =>
  model.reference === reference || model.aliases.some((alias) => `${model.name}@${alias}` === reference);

if (document.getElementById("plane")) void new Workbench().begin();
