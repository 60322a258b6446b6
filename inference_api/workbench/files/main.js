// The page: its state, and how its parts interact.

/** @import {Camera, Configuration, End, Robot} from "./geometry.js" */
/** @import {Listed} from "./models-view.js" */
/** @import {State} from "./state.js" */

import { ask } from "./api.js";
import { Controls } from "./controls.js";
import { along, bound } from "./geometry.js";
import { Messages } from "./messages.js";
import { showModels } from "./models-view.js";
import { encodePng, fromBase64, render, toBase64 } from "./picture.js";
import { Planner } from "./planner.js";
import { Readout } from "./readout.js";
import { SceneView } from "./scene-view.js";
import { Side } from "./side.js";
import { fromHash, toHash } from "./state.js";
import { byId } from "./svg.js";
import { listenToCopies } from "./take.js";

const GHOSTS = 14;
// Parts of the state that another plan belongs to.
const PLAN = ["planSeed", "limit", "paths", "minConfidence", "planner", "feed", "budget"];

class Workbench {
  constructor() {
    /** @type {State} */
    this.state = fromHash(location.hash);
    this.about = { version: "", truth: false, plans: false, mlflow: /** @type {string | null} */ (null) };
    /** @type {Listed[]} */
    this.models = [];
    /** @type {Robot | null} */
    this.robot = null;
    /** @type {Camera | null} */
    this.camera = null;
    this.chosen = -1;
    /** The selected model. @type {Listed | null} */
    this.listed = null;
    /** @type {Configuration | null} */
    this.peek = null;
    /** The picture of these discs. @type {{of: object | null, image: Promise<string>}} */
    this.rendered = { of: null, image: Promise.resolve("") };
    /** @type {Uint8Array<ArrayBuffer> | null} */
    this.png = null;
    this.pictureAddress = "";
    /** Which uploaded picture that is the address of. */
    this.seen = "";
    /** @type {number | undefined} */
    this.frame = undefined;
    this.messages = new Messages(() => void this.begin());
    this.first = new Side(this, "torus", "model");
    this.beside = new Side(this, "torus-beside", "beside");
    this.planner = new Planner(this);
    this.readout = new Readout(this);
    this.controls = new Controls(this);
    listenToCopies(this);
    addEventListener("hashchange", () => this.opened());
  }

  /** Ask what there is, then show it. */
  async begin() {
    try {
      const [about, listed] = await Promise.all([ask("workbench/about"), ask("models")]);
      this.about = about;
      this.models = listed.models;
      this.controls.listModels(listed);
      this.choose(this.state.model);
      this.controls.ready();
      showModels(listed.models, await ask("workbench/models"), listed.registry, (reference) => {
        this.change({ model: reference, view: "plane" });
        this.choose(reference);
      });
    } catch (error) {
      this.messages.failed(error);
    }
  }

  /** Whether plans are trees among the discs, not what the model predicts. */
  get grows() {
    const { state, about } = this;
    return Boolean(state.planner) && about.truth && !state.picture;
  }

  /** The discs as requests have them. */
  discs() {
    return { discs: this.state.discs.map(({ x, y, r }) => [x, y, r]) };
  }

  /** Models whose answers are shown: the one that was chosen, and one beside it. */
  sides() {
    return this.state.beside ? [this.first, this.beside] : [this.first];
  }

  /** Make room for a model's robot. @param {string} reference */
  choose(reference) {
    const planar = this.models.filter((model) => model.world?.kind === "planar");
    const wanted = planar.find((model) => (reference ? named(model, reference) : model.default)) ?? planar[0];
    if (!wanted) return;
    this.listed = wanted;
    const others = planar.filter((model) => model !== wanted && model.robot === wanted.robot);
    const { beside } = this.state;
    // What is not in the list may be there all the same; its question tells.
    const fits = others.some((model) => named(model, beside)) || !this.models.some((model) => named(model, beside));
    this.controls.listOthers(others, fits ? beside : "");
    this.rendered.of = null;
    const { robot, camera } = wanted.world;
    const space = wanted.joint_space;
    this.robot = {
      links: robot.link_lengths_m,
      halfWidth: robot.half_width_m,
      low: space.lower ?? robot.link_lengths_m.map(() => -Math.PI),
      high: space.upper ?? robot.link_lengths_m.map(() => Math.PI),
      circle: space.periodic ?? robot.link_lengths_m.map(() => true),
    };
    this.camera = {
      left: camera.x_min_m, right: camera.x_max_m, bottom: camera.y_min_m, top: camera.y_max_m, pixels: camera.pixels,
    };
    this.scene = new SceneView(byId("scene", SVGSVGElement), this.robot, this.camera, {
      disc: (at, disc, byKey) => this.controls.moveDisc(at, disc, byKey),
      choose: (at) => this.chooseDisc(at),
      remove: (at) => this.controls.removeDisc(at),
      end: (end, configuration) => this.moveEnd(end, configuration),
    });
    this.first.make(this.robot);
    this.beside.make(this.robot);
    this.controls.makeJoints(this.robot);
    const { start, goal, model } = this.state;
    this.change({ model, beside: fits ? beside : "", start: bound(this.robot, start), goal: bound(this.robot, goal) });
  }

  /** Show a whole scene. @param {Pick<State, "discs" | End | "model">} scene */
  showScene(scene) {
    this.chosen = -1;
    this.state = { ...this.state, ...scene, picture: null };
    this.choose(scene.model);
  }

  /** An address was opened in this page. */
  opened() {
    if (location.hash === toHash(this.state)) return;
    this.state = fromHash(location.hash);
    this.choose(this.state.model);
  }

  /** Change what is shown. @param {Partial<State>} changes */
  change(changes) {
    const scene = ["discs", "picture", "start", "goal", "model", "beside"].some((name) => name in changes);
    const sampled = scene || ["n", "seed", "confidence", "ground"].some((name) => name in changes);
    this.state = { ...this.state, ...changes };
    if (scene || PLAN.some((name) => name in changes) || (sampled && this.state.feed === "shown")) this.planner.forget();
    this.draw();
    if (sampled || changes.view === "plane") {
      for (const side of this.sides()) side.changed(side.part in changes);
    }
    this.remember();
  }

  /** Keep the state in the address, at most some times a second, as browsers want it. */
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
    // Of more joints than two, the map shows the start's others.
    if (this.robot.links.length > 2) this.sides().forEach((side) => side.changed(false));
  }

  /** @param {number} at */
  chooseDisc(at) {
    this.chosen = at;
    this.draw();
  }

  /** @param {number | null} first @param {number} second */
  peeked(first, second) {
    this.peek = first === null ? null : [first, second, ...this.state.start.slice(2)];
    this.draw();
  }

  /** Draw at the next frame; several changes before it are drawn together. */
  draw() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      this.drawNow();
    });
  }

  drawNow() {
    if (!this.robot || !this.scene) return;
    const { state, robot, planner } = this;
    const { path } = this.first;
    const ghosts = path.length
      ? Array.from({ length: GHOSTS }, (_, at) => along(robot, path, (at + 1) / (GHOSTS + 1)))
      : [];
    const [moving, other] = [this.first, this.beside].map((side) =>
      side.path.length ? along(robot, side.path, planner.player.share) : null,
    );
    this.scene.show({
      discs: state.discs, chosen: this.chosen, start: state.start, goal: state.goal, ghosts, moving, other,
      least: this.first.uncertainty.least,
      peek: this.peek, picture: state.picture ? this.pictureAddress : null,
    });
    const { start, goal } = state;
    this.first.torus?.showEnds({ start, goal, path, moving, ...this.first.uncertainty });
    this.beside.torus?.showEnds({ start, goal, path: this.beside.path, moving: other, ...this.beside.uncertainty });
    for (const side of this.sides()) side.torus?.showTree(side.planned?.answer ?? null);
    this.controls.show();
  }

  /** The picture as it is sent, and shown as it is sent: base64 of a PNG. */
  async pictured() {
    if (!this.robot || !this.camera) throw new Error("there is no robot yet");
    const { picture, discs } = this.state;
    if (picture) {
      if (picture !== this.seen) this.see(picture, this.camera.pixels);
      return picture;
    }
    this.seen = "";
    if (this.rendered.of !== discs) {
      const pixels = render(this.robot, this.camera, discs);
      this.controls.showPixels(pixels, this.camera.pixels);
      this.rendered = { of: discs, image: encodePng(pixels).then((png) => toBase64((this.png = png))) };
    }
    return this.rendered.image;
  }

  /** Show an uploaded picture. @param {string} picture @param {number} side */
  see(picture, side) {
    this.seen = picture;
    this.rendered.of = null;
    this.png = fromBase64(picture);
    const file = new Blob([this.png], { type: "image/png" });
    URL.revokeObjectURL(this.pictureAddress);
    this.pictureAddress = URL.createObjectURL(file);
    void this.controls.showFile(file, side);
    this.draw();
  }
}

/** @param {Listed} model @param {string} reference */
function named(model, reference) {
  return model.reference === reference || model.aliases.some((alias) => `${model.name}@${alias}` === reference);
}

export { Workbench };

if (document.getElementById("plane")) void new Workbench().begin();
