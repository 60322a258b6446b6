// Everything beside the drawings: fields, buttons, figures.

/** @import {Configuration, Disc, Robot} from "./geometry.js" */
/** @import {Workbench} from "./main.js" */
/** @import {Listed} from "./models-view.js" */

import { ask } from "./api.js";
import { degrees } from "./geometry.js";
import { speak } from "./messages.js";
import { openFile } from "./scene-file.js";
import { MAX_DISCS, clamp } from "./state.js";
import { byId } from "./svg.js";

const ENDS = /** @type {const} */ (["start", "goal"]);

export class Controls {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    /** @type {Record<"start" | "goal", {slider: HTMLInputElement, told: HTMLOutputElement}[]>} */
    this.joints = { start: [], goal: [] };
    this.select = byId("model", HTMLSelectElement);
    this.others = byId("beside", HTMLSelectElement);
    this.picture = byId("picture", HTMLCanvasElement);
    this.radius = byId("radius", HTMLInputElement);
    this.listen();
    this.listenToFiles();
    this.showView();
  }

  listen() {
    const { bench } = this;
    this.select.addEventListener("change", () => {
      bench.state = { ...bench.state, model: this.select.value };
      bench.choose(this.select.value);
    });
    this.others.addEventListener("change", () => bench.change({ beside: this.others.value }));
    for (const view of /** @type {const} */ (["plane", "space", "models"])) {
      byId(`to-${view}`, HTMLElement).addEventListener("click", () => bench.change({ view }));
    }
    byId("add-disc", HTMLButtonElement).addEventListener("click", () => this.addDisc());
    byId("remove-disc", HTMLButtonElement).addEventListener("click", () => this.removeDisc(bench.chosen));
    this.radius.addEventListener("input", () => {
      const disc = bench.state.discs[bench.chosen];
      if (disc) this.moveDisc(bench.chosen, { ...disc, r: Number(this.radius.value) });
    });
    const count = byId("count", HTMLInputElement);
    count.addEventListener("input", () => bench.change({ n: clamp(count.value, 1, 2000, bench.state.n, true) }));
    count.addEventListener("change", () => (count.value = String(bench.state.n)));
    const seed = byId("seed", HTMLInputElement);
    seed.addEventListener("input", () => {
      if (/^[0-9]{1,20}$/.test(seed.value)) bench.change({ seed: seed.value });
    });
    const confidence = byId("confidence", HTMLSelectElement);
    confidence.addEventListener("change", () => {
      bench.change({ confidence: confidence.value === "" ? null : Number(confidence.value) });
    });
    const ground = byId("ground", HTMLSelectElement);
    ground.addEventListener("change", () => {
      for (const side of bench.sides()) side.drawn.ground = null;
      bench.change({ ground: /** @type {"truth" | "belief" | "none"} */ (ground.value) });
    });
    byId("family-form", HTMLFormElement).addEventListener("submit", (event) => {
      event.preventDefault();
      void this.drawFamily();
    });
  }

  listenToFiles() {
    const open = byId("open", HTMLInputElement);
    open.addEventListener("change", () => {
      const file = open.files?.[0];
      if (file) void openFile(this.bench, file);
      // The same file again is a change, too.
      open.value = "";
    });
    // Dropped beside what takes it, a file would be opened instead of the page.
    addEventListener("dragover", (event) => event.preventDefault());
    addEventListener("drop", (event) => {
      event.preventDefault();
      const file = event.dataTransfer?.files[0];
      if (file && this.bench.state.view === "plane") void openFile(this.bench, file);
    });
    byId("back", HTMLButtonElement).addEventListener("click", () => this.bench.change({ picture: null }));
    byId("save", HTMLAnchorElement).addEventListener("click", (event) => {
      const { png } = this.bench;
      if (!png) return event.preventDefault();
      URL.revokeObjectURL(this.saved ?? "");
      this.saved = URL.createObjectURL(new Blob([png], { type: "image/png" }));
      byId("save", HTMLAnchorElement).href = this.saved;
    });
  }

  /** @param {{models: Listed[]}} listed */
  listModels(listed) {
    const planar = listed.models.filter((model) => model.world?.kind === "planar");
    offer(this.select, "the default", planar, this.bench.state.model);
  }

  /** Models of the same robot, to look at beside the one that is chosen. @param {Listed[]} models @param {string} chosen */
  listOthers(models, chosen) {
    this.others.disabled = !models.length && !chosen;
    offer(this.others, this.others.disabled ? "no other model of this robot" : "nothing", models, chosen);
  }

  /** The server has told what it can do. */
  ready() {
    const { about } = this.bench;
    byId("plan", HTMLButtonElement).title = about.plans ? "" : "this server does not plan";
    const truth = byId("ground", HTMLSelectElement).options[0];
    truth.disabled = !about.truth;
    truth.textContent = about.truth ? "collisions in truth" : "collisions in truth (off on this server)";
    byId("family-form", HTMLFormElement).hidden = !about.truth;
  }

  /** @param {Robot} robot */
  makeJoints(robot) {
    const rows = ENDS.flatMap((end) => {
      this.joints[end] = [];
      return robot.links.map((_, joint) => this.makeJoint(robot, end, joint));
    });
    byId("joints", HTMLElement).replaceChildren(...rows);
  }

  /** @param {Robot} robot @param {"start" | "goal"} end @param {number} joint */
  makeJoint(robot, end, joint) {
    const row = document.createElement("label");
    row.className = "joint";
    const slider = document.createElement("input");
    Object.assign(slider, { type: "range", step: "0.01" });
    slider.min = String(robot.low[joint]);
    slider.max = String(robot.high[joint]);
    const told = document.createElement("output");
    slider.addEventListener("input", () => {
      const configuration = [...this.bench.state[end]];
      configuration[joint] = Math.min(robot.high[joint] - 1e-6, Number(slider.value));
      this.bench.moveEnd(end, configuration);
    });
    row.append(`${end} ${joint + 1}`, slider, told);
    this.joints[end].push({ slider, told });
    return row;
  }

  /** Fields follow the state. */
  show() {
    const { state, chosen } = this.bench;
    for (const end of ENDS) {
      this.joints[end].forEach(({ slider, told }, joint) => {
        slider.value = String(state[end][joint]);
        slider.setAttribute("aria-valuetext", degrees(state[end][joint]));
        told.textContent = degrees(state[end][joint]);
      });
    }
    const disc = state.picture ? undefined : state.discs[chosen];
    byId("disc-told", HTMLOutputElement).textContent = disc
      ? `disc ${chosen + 1}: x ${disc.x.toFixed(2)}, y ${disc.y.toFixed(2)}, r ${disc.r.toFixed(2)} m`
      : state.picture ? "a picture, not discs" : "no disc chosen";
    byId("remove-disc", HTMLButtonElement).disabled = !disc;
    byId("add-disc", HTMLButtonElement).disabled = Boolean(state.picture) || state.discs.length >= MAX_DISCS;
    this.radius.disabled = !disc;
    if (disc) this.radius.value = String(disc.r);
    keep("count", String(state.n));
    keep("seed", state.seed);
    byId("confidence", HTMLSelectElement).value = state.confidence === null ? "" : String(state.confidence);
    byId("ground", HTMLSelectElement).value = state.ground;
    this.select.value = state.model;
    this.others.value = state.beside;
    byId("beside-figure", HTMLElement).hidden = !state.beside;
    byId("figures", HTMLElement).classList.toggle("three", Boolean(state.beside));
    byId("back", HTMLButtonElement).hidden = !state.picture;
    this.showView();
  }

  showView() {
    const { view } = this.bench.state;
    byId("model-label", HTMLElement).hidden = view === "space";
    const last = view === "models" ? null : byId(`${view}-last`, HTMLElement);
    const take = byId("take", HTMLElement);
    // Moving it takes the focus from what is in it.
    if (last && take.parentElement !== last) last.append(take);
    for (const name of ["plane", "space", "models"]) {
      byId(name, HTMLElement).hidden = view !== name;
      byId(`to-${name}`, HTMLElement).setAttribute("aria-pressed", String(view === name));
    }
  }

  /** @param {Uint8ClampedArray<ArrayBuffer>} pixels @param {number} side */
  showPixels(pixels, side) {
    if (this.picture.width !== side) this.picture.width = this.picture.height = side;
    this.picture.getContext("2d")?.putImageData(new ImageData(pixels, side, side), 0, 0);
  }

  /** The same of an uploaded file; nothing where it is no picture. @param {Blob} file @param {number} side */
  async showFile(file, side) {
    const context = this.picture.getContext("2d");
    context?.clearRect(0, 0, side, side);
    const bitmap = await createImageBitmap(file, { resizeWidth: side, resizeHeight: side, resizeQuality: "high" }).catch(
      () => null,
    );
    if (bitmap) context?.drawImage(bitmap, 0, 0);
  }

  addDisc() {
    const { bench } = this;
    const places = [[2.4, -1.8], [-1.8, -2.4], [0, 3], [3, 0], [-3, 0]];
    const [x, y] = places[bench.state.discs.length % places.length];
    bench.chosen = bench.state.discs.length;
    bench.change({ discs: [...bench.state.discs, { x, y, r: 1 }] });
    speak(`Disc ${bench.chosen + 1} added`);
    requestAnimationFrame(() => bench.scene?.focusDisc(bench.chosen));
  }

  /** @param {number} at */
  removeDisc(at) {
    const { bench } = this;
    if (!bench.state.discs[at]) return;
    bench.chosen = -1;
    bench.change({ discs: bench.state.discs.filter((_, place) => place !== at) });
    speak(`Disc ${at + 1} removed`);
    requestAnimationFrame(() => {
      if (bench.state.discs.length) bench.scene?.focusDisc(Math.min(at, bench.state.discs.length - 1));
      else byId("add-disc", HTMLButtonElement).focus();
    });
  }

  /** @param {number} at @param {Disc} disc @param {boolean} [byKey]  Said then, for it may not be seen. */
  moveDisc(at, disc, byKey = false) {
    const camera = this.bench.camera;
    if (!camera) return;
    const moved = {
      x: Math.min(camera.right, Math.max(camera.left, disc.x)),
      y: Math.min(camera.top, Math.max(camera.bottom, disc.y)),
      r: Math.min(2.5, Math.max(0.2, disc.r)),
    };
    this.bench.change({ discs: this.bench.state.discs.map((one, place) => (place === at ? moved : one)) });
    if (byKey) speak(`Disc ${at + 1}: x ${moved.x.toFixed(1)}, y ${moved.y.toFixed(1)}, radius ${moved.r.toFixed(2)}`);
  }

  /** A click into the joint space. @param {number} first @param {number} second */
  clicked(first, second) {
    const chosen = document.querySelector("input[name=end]:checked");
    const end = chosen instanceof HTMLInputElement && chosen.value === "start" ? "start" : "goal";
    this.bench.moveEnd(end, [first, second, ...this.bench.state[end].slice(2)]);
  }

  async drawFamily() {
    const { bench } = this;
    const family = byId("family", HTMLSelectElement).value;
    const seed = clamp(byId("family-seed", HTMLInputElement).value, 0, 999999, 0, true);
    try {
      const model = bench.state.model ? { model: bench.state.model } : {};
      const scene = await ask("workbench/scene", { ...model, ...(family ? { family } : {}), seed });
      const discs = scene.discs.map((/** @type {number[]} */ [x, y, r]) => ({ x, y, r }));
      bench.showScene({ discs, start: scene.start, goal: scene.goal, model: bench.state.model });
    } catch (error) {
      bench.messages.failed(error);
    }
  }
}

/** @param {HTMLSelectElement} select @param {string} none @param {Listed[]} models @param {string} chosen */
function offer(select, none, models, chosen) {
  const options = models.map(
    ({ reference, aliases }) => new Option(`${reference}${aliases.length ? ` (${aliases.join(", ")})` : ""}`, reference),
  );
  if (chosen && !options.some((option) => option.value === chosen)) options.push(new Option(chosen, chosen));
  select.replaceChildren(new Option(none, ""), ...options);
  select.value = chosen;
}

/** Leave a field alone in which somebody is writing. @param {string} id @param {string} text */
function keep(id, text) {
  const field = byId(id, HTMLInputElement);
  if (document.activeElement !== field) field.value = text;
}
