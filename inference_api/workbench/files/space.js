// The view of an arm in space: its scene, its cameras, samples, and a way.

/** @import {End} from "./geometry.js" */
/** @import {Workbench} from "./main.js" */
/** @import {SerialArm} from "./solid.js" */

import { ask } from "./api.js";
import { offerNames } from "./messages.js";
import { LOOKING, say, verdictOf } from "./planner.js";
import { Player } from "./player.js";
import { asking } from "./side.js";
import { around, looking } from "./solid.js";
import { SpaceDrawing } from "./space-drawing.js";
import { JointSliders } from "./space-joints.js";
import { Previews, showSpaceNumbers } from "./space-readout.js";
import { byId, inputOf, selectOf } from "./svg.js";

const FOCUS = /** @type {[number, number, number]} */ ([0.45, 0, 0.35]);
const SAMPLES = 60;
const PLAY_MS = 5000;
// Where further cameras stand from the first one, rad.
const ASIDE = [0, 1.3, -1.3];

export class Space {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    this.drawing = new SpaceDrawing(byId("space-drawing", HTMLCanvasElement));
    /** @type {SerialArm | null} */
    this.arm = null;
    /** @type {any} */
    this.scene = null;
    /** @type {any} */
    this.answer = null;
    /** @type {boolean[] | null} */
    this.free = null;
    /** @type {number[][]} */
    this.path = [];
    this.player = new Player("space-play", "space-along", PLAY_MS, () => this.draw());
    /** @type {number | undefined} */
    this.frame = undefined;
    this.joints = new JointSliders((end, configuration) => this.moveEnd(end, configuration));
    this.dirty = false;
    this.busy = false;
    this.failed = false;
    /** The question whose scene is shown. */
    this.asked = "";
    this.previews = new Previews();
    /** Of which scene the view was chosen. */
    this.faced = "";
    this.told = byId("space-told");
    this.listen();
  }

  listen() {
    for (const id of ["view-side", "view-up"]) {
      byId(id).addEventListener("input", () => this.turnView());
    }
    for (const id of ["camera-count", "camera-side", "camera-up", "camera-away"]) {
      byId(id).addEventListener("input", () => {
        this.bench.change({ cameras: this.readCameras(id) });
        this.changed();
      });
    }
    byId("space-form", HTMLFormElement).addEventListener("submit", (event) => {
      event.preventDefault();
      const seed = inputOf("space-seed").value;
      const family = selectOf("space-family").value;
      this.bench.change({ family, sceneSeed: Number(seed) || 0, from: null, to: null });
      this.changed();
    });
    byId("space-plan").addEventListener("click", () => void this.plan());
    byId("space-sure").addEventListener("change", () => this.forget());
    this.listenToDrag();
  }

  /** The drawing turns with the pointer; sliders do the same for keys. */
  listenToDrag() {
    const { canvas } = this.drawing;
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      const [side, up] = [inputOf("view-side"), inputOf("view-up")];
      side.value = String(Number(side.value) - 0.4 * event.movementX);
      up.value = String(Number(up.value) + 0.4 * event.movementY);
      this.turnView();
    });
  }

  turnView() {
    this.drawing.side = (Number(inputOf("view-side").value) * Math.PI) / 180;
    this.drawing.up = (Number(inputOf("view-up").value) * Math.PI) / 180;
    this.draw();
  }

  /** The view was opened. */
  open() {
    const model = this.bench.models.find((one) => one.world?.kind === "spatial");
    const able = this.bench.about.truth && Boolean(model);
    byId("space-none").hidden = able;
    byId("space-body").hidden = !able;
    if (!able || !model) return;
    this.model = model.reference;
    if (this.arm !== model.world.robot) this.joints.make(model.world.robot);
    this.arm = model.world.robot;
    const { sceneSeed, cameras } = this.bench.state;
    inputOf("space-seed").value = String(sceneSeed);
    if (cameras) {
      const [count, side, up, away] = cameras;
      selectOf("camera-count").value = String(count);
      Object.entries({ side, up, away }).forEach(([name, value]) => {
        inputOf(`camera-${name}`).value = String(value);
      });
    }
    const shown = JSON.stringify(this.body());
    if (this.failed || shown !== this.asked) this.changed();
    else this.draw();
  }

  /**
   * How many, degrees, degrees, m; of the first. Null for those of the scene.
   * @param {string} moved  What was set: who turns a camera wants one that turns.
   * @returns {number[] | null}
   */
  readCameras(moved) {
    const select = selectOf("camera-count");
    if (select.value === "0" && moved !== "camera-count") select.value = "1";
    const count = Number(select.value);
    if (count === 0) return null;
    const rest = ["side", "up", "away"].map((name) => Number(inputOf(`camera-${name}`).value));
    return [count, ...rest];
  }

  poses() {
    const { cameras } = this.bench.state;
    if (!cameras) return null;
    const [count, side, up, away] = cameras;
    return ASIDE.slice(0, count).map((aside) =>
      looking(around(FOCUS, (side * Math.PI) / 180 + aside, (up * Math.PI) / 180, away), FOCUS),
    );
  }

  body() {
    const { family, sceneSeed } = this.bench.state;
    const from = this.fitted(this.bench.state.from);
    const cameras = this.poses();
    return {
      model: this.model, seed: sceneSeed, ...(family ? { family } : {}), ...(cameras ? { cameras } : {}),
      ...(from ? { state: from } : {}),
    };
  }

  /** What the samples and the way of what is shown are asked with. */
  bodies() {
    const { model, scene } = this;
    const { seed, sure } = this.bench.state;
    return {
      sample: { model, image: scene.image, n: SAMPLES, seed, min_confidence: 0 },
      plan: { model, image: scene.image, ...this.ends(), seed, time_limit_s: 5, ...asking(sure) },
    };
  }

  /** Something has changed: ask again, one question at a time. */
  changed() {
    this.dirty = true;
    this.forget();
    if (!this.busy) void this.refresh();
  }

  /** What was planned does not fit any more. */
  forget() {
    this.path = [];
    this.player.load(false);
    say(this.told, "");
  }

  async refresh() {
    this.busy = true;
    this.drawing.canvas.setAttribute("aria-busy", "true");
    try {
      while (this.dirty) {
        this.dirty = false;
        this.failed = false;
        if (!this.scene) say(this.told, "Drawing a scene. The first one after an installation takes up to a minute.");
        const body = this.body();
        this.asked = JSON.stringify(body);
        this.see(await ask("workbench/space", body));
        if (this.path.length === 0) say(this.told, "");
        this.answer = await ask("sample", this.bodies().sample);
        this.free = null;
        showSpaceNumbers(this.answer, this.free);
        this.draw();
        if (this.dirty) continue;
        const judged = await ask("workbench/space", { ...body, configurations: this.answer.samples });
        if (!this.dirty) this.free = judged.sample_free;
        showSpaceNumbers(this.answer, this.free);
        this.draw();
        this.bench.messages.clear();
        this.bench.messages.here(`${this.answer.samples.length} samples in space`);
      }
    } catch (error) {
      this.failed = true;
      this.bench.messages.failed(error);
    } finally {
      this.busy = false;
      this.drawing.canvas.setAttribute("aria-busy", "false");
    }
  }

  /** @param {any} scene */
  see(scene) {
    this.scene = scene;
    offerNames("space-family", scene.families);
    selectOf("space-family").value = scene.family;
    this.joints.show(this.ends());
    this.previews.show(scene.previews);
    this.face(scene);
    this.draw();
  }

  /** Look at a new scene from where its first camera does, a little from the side. @param {any} scene */
  face(scene) {
    const name = `${scene.family} ${this.bench.state.sceneSeed}`;
    if (name === this.faced) return;
    this.faced = name;
    const [x, y] = scene.cameras[0].pose;
    const bearing = (Math.atan2(y[3], x[3]) * 180) / Math.PI + 25;
    inputOf("view-side").value = String(bearing > 180 ? bearing - 360 : bearing);
    this.turnView();
  }

  /** @param {End} end @param {number[]} configuration */
  moveEnd(end, configuration) {
    this.bench.change(end === "start" ? { from: configuration } : { to: configuration });
    this.forget();
    this.joints.show(this.ends());
    // The arm stands at the start while it is looked at.
    if (end === "start") this.changed();
  }

  /** What an address says of an arm with other joints is nothing. @param {number[] | null} configuration */
  fitted(configuration) {
    return configuration?.length === this.arm?.joints.length ? configuration : null;
  }

  ends() {
    const { from, to } = this.bench.state;
    return { start: this.fitted(from) ?? this.scene.start, goal: this.fitted(to) ?? this.scene.goal };
  }

  async plan() {
    if (!this.scene) return;
    const { scene } = this;
    say(this.told, LOOKING);
    try {
      const answer = await ask("plan", this.bodies().plan);
      if (scene !== this.scene) return;
      if (answer.status !== "solved") return say(this.told, `Not solved: ${answer.reason}.`, true);
      this.path = answer.path;
      this.player.load(true);
      const { way } = await ask("workbench/space", { ...this.body(), path: answer.path });
      say(this.told, `Confidence ${answer.confidence.toFixed(3)}, ${answer.length_rad.toFixed(2)} rad. Checked against the obstacles: ${verdictOf(way)}.`, !way.free);
      this.player.begin();
    } catch (error) {
      say(this.told, "");
      this.bench.messages.failed(error);
    }
  }

  /** The configuration along the way; joints with limits go straight. */
  moving() {
    const pieces = this.path.length - 1;
    if (pieces < 1) return null;
    const at = Math.min(pieces - 1, Math.floor(this.player.share * pieces));
    const part = this.player.share * pieces - at;
    return this.path[at].map((angle, joint) => angle + part * (this.path[at + 1][joint] - angle));
  }

  draw() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      const { arm, scene, answer } = this;
      if (!arm || !scene || this.bench.state.view !== "space") return;
      const moving = this.moving();
      const samples = moving ? [] : (answer?.samples ?? []);
      this.drawing.draw(arm, {
        faces: scene.faces, cameras: scene.cameras, way: this.path,
        arms: [
          { configuration: moving ?? this.ends().start, kind: moving ? "moving" : "start" },
          { configuration: this.ends().goal, kind: "goal" },
        ],
        samples: samples.map((/** @type {number[]} */ configuration, /** @type {number} */ at) => ({
          configuration, confidence: answer.confidence?.[at] ?? 1, free: this.free ? this.free[at] : null,
        })),
      });
    });
  }
}
