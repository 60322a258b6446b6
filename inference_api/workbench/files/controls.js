// Everything beside the drawings: fields, buttons, figures.

/** @import {Disc, End, Robot} from "./geometry.js" */
/** @import {Workbench} from "./main.js" */
/** @import {Listed} from "./models-view.js" */

import { ask } from "./api.js";
import { degrees } from "./geometry.js";
import { entry, speak } from "./messages.js";
import { openFile } from "./scene-file.js";
import { MAX_DISCS, clamp, isSeed } from "./state.js";
import { ENDS, buttonOf, byId, inputOf, selectOf } from "./svg.js";

/** Fields of numbers: id, name in the state, least, most, whether whole. */
const NUMBERS = /** @type {const} */ ([
  ["count", "n", 1, 2000, true],
  ["plan-limit", "limit", 0.01, 10, false],
  ["plan-paths", "paths", 1, 64, true],
  ["plan-budget", "budget", 1, 20000, true],
]);
/** Fields of confidences: empty for the model's own. */
const CONFIDENCES = /** @type {const} */ ([["confidence", "confidence"], ["plan-min-confidence", "minConfidence"]]);
const CHOICES = /** @type {const} */ ([["planner", "planner"], ["feed", "feed"]]);
const SEEDS = /** @type {const} */ ([["seed", "seed"], ["plan-seed", "planSeed"]]);

export class Controls {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    /** @type {ReturnType<typeof jointRows>[]} */
    this.joints = [];
    this.select = selectOf("model");
    this.others = selectOf("beside");
    this.picture = byId("picture", HTMLCanvasElement);
    this.radius = inputOf("radius");
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
    for (const view of /** @type {const} */ (["plane", "models"])) {
      byId(`to-${view}`).addEventListener("click", () => bench.change({ view }));
    }
    byId("add-disc").addEventListener("click", () => this.addDisc());
    byId("remove-disc").addEventListener("click", () => this.removeDisc(bench.chosen));
    this.radius.addEventListener("input", () => {
      const disc = bench.state.discs[bench.chosen];
      if (disc) this.moveDisc(bench.chosen, { ...disc, r: Number(this.radius.value) });
    });
    for (const [id, name, low, high, whole] of NUMBERS) {
      const field = inputOf(id);
      field.addEventListener("input", () => bench.change({ [name]: clamp(field.value, low, high, bench.state[name], whole) }));
      field.addEventListener("change", () => (field.value = String(bench.state[name])));
    }
    for (const [id, name] of SEEDS) {
      const field = inputOf(id);
      field.addEventListener("input", () => {
        if (isSeed(field.value)) bench.change({ [name]: field.value });
      });
    }
    for (const [id, name] of CONFIDENCES) {
      const select = selectOf(id);
      for (const text of ["", "0", "0.2", "0.5", "0.9", "0.99"]) offerConfidence(select, text);
      select.addEventListener("change", () => bench.change({ [name]: select.value === "" ? null : Number(select.value) }));
    }
    for (const [id, name] of CHOICES) {
      const select = selectOf(id);
      select.addEventListener("change", () => bench.change({ [name]: select.value }));
    }
    const ground = selectOf("ground");
    ground.addEventListener("change", () => {
      for (const side of bench.sides()) side.shown.ground = null;
      bench.change({ ground: /** @type {"truth" | "prediction" | "none"} */ (ground.value) });
    });
    byId("family-form", HTMLFormElement).addEventListener("submit", (event) => {
      event.preventDefault();
      void this.drawFamily();
    });
  }

  listenToFiles() {
    const open = inputOf("open");
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
    byId("back").addEventListener("click", () => this.bench.change({ picture: null }));
    byId("save").addEventListener("click", (event) => {
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
    offer(this.select, "default", planar, this.bench.state.model);
  }

  /** Models of the same robot, to look at beside the one that is chosen. @param {Listed[]} models @param {string} chosen */
  listOthers(models, chosen) {
    this.others.disabled = !models.length && !chosen;
    offer(this.others, this.others.disabled ? "no other model of this robot" : "none", models, chosen);
  }

  /** The server has reported what it can do. */
  ready() {
    const { about } = this.bench;
    buttonOf("plan").title = about.plans ? "" : "this server cannot plan";
    const truth = selectOf("ground").options[0];
    truth.disabled = !about.truth;
    truth.textContent = `collisions (ground truth${about.truth ? "" : ": off on this server"})`;
    byId("family-form", HTMLFormElement).hidden = !about.truth;
    byId("planner-label").hidden = !about.truth;
  }

  /** @param {Robot} robot */
  makeJoints({ low, high }) {
    const limits = low.map((least, joint) => [least, high[joint]]);
    this.joints = ENDS.map((end) => jointRows(end, limits, (configuration) => this.bench.moveEnd(end, configuration)));
    byId("joints").replaceChildren(...this.joints.flatMap(({ rows }) => rows));
  }

  /** Fields follow the state. */
  show() {
    const { state, chosen } = this.bench;
    this.joints.forEach(({ show }, row) => show(state[ENDS[row]]));
    const disc = state.picture ? undefined : state.discs[chosen];
    byId("disc-status", HTMLOutputElement).textContent = disc
      ? `disc ${chosen + 1}: x ${disc.x.toFixed(2)}, y ${disc.y.toFixed(2)}, r ${disc.r.toFixed(2)} m`
      : state.picture ? "uploaded picture, no discs" : "no disc selected";
    buttonOf("remove-disc").disabled = !disc;
    buttonOf("add-disc").disabled = Boolean(state.picture) || state.discs.length >= MAX_DISCS;
    this.radius.disabled = !disc;
    if (disc) this.radius.value = String(disc.r);
    for (const [id, name] of [...NUMBERS, ...SEEDS]) keep(id, String(state[name]));
    for (const [id, name] of CONFIDENCES) {
      const text = String(state[name] ?? "");
      // That of an address may be another than those that are offered.
      offerConfidence(selectOf(id), text);
      selectOf(id).value = text;
    }
    for (const [id, name] of CHOICES) selectOf(id).value = state[name];
    const { grows } = this.bench;
    byId("predicted").hidden = grows;
    byId("grown").hidden = !grows;
    selectOf("ground").value = state.ground;
    this.select.value = state.model;
    this.others.value = state.beside;
    byId("beside-figure").hidden = !state.beside;
    byId("figures").classList.toggle("three", Boolean(state.beside));
    buttonOf("back").hidden = !state.picture;
    this.showView();
  }

  showView() {
    const { view } = this.bench.state;
    for (const name of ["plane", "models"]) {
      byId(name).hidden = view !== name;
      byId(`to-${name}`).setAttribute("aria-pressed", String(view === name));
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
      else buttonOf("add-disc").focus();
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
    const family = selectOf("family").value;
    const seed = clamp(inputOf("family-seed").value, 0, 999999, 0, true);
    try {
      const scene = await ask("workbench/scene", { ...bench.first.model, ...(family ? { family } : {}), seed });
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

/** @param {HTMLSelectElement} select @param {string} text  Empty for none. */
function offerConfidence(select, text) {
  if ([...select.options].some((option) => option.value === text)) return;
  select.append(new Option(text === "0" ? "any" : text || "model default", text));
}

/** Leave a field alone in which somebody is writing. @param {string} id @param {string} text */
function keep(id, text) {
  const field = inputOf(id);
  if (document.activeElement !== field) field.value = text;
}

/**
 * A slider, and what shows an angle on it.
 * @param {string} words
 * @param {number} low  rad.
 * @param {number} high  rad.
 * @param {(angle: number) => void} moved
 */
function jointRow(words, low, high, moved) {
  const row = entry("label", "", "joint");
  const slider = entry("input");
  Object.assign(slider, { type: "range", min: low, max: high, step: 0.01 });
  const output = entry("output");
  slider.addEventListener("input", () => moved(Math.min(high - 1e-6, Math.max(low, Number(slider.value)))));
  row.append(words, slider, output);
  const show = (/** @type {number} */ angle) => {
    slider.value = String(angle);
    output.textContent = degrees(angle);
    slider.setAttribute("aria-valuetext", output.textContent);
  };
  return { row, show };
}

/**
 * A row for each joint of a configuration.
 * @param {string} words
 * @param {number[][]} limits  rad, of each joint.
 * @param {(configuration: number[]) => void} moved
 */
function jointRows(words, limits, moved) {
  /** @type {number[]} */
  let now = [];
  const made = limits.map(([low, high], joint) =>
    jointRow(`${words} ${joint + 1}`, low, high, (angle) => moved(now.map((one, at) => (at === joint ? angle : one)))),
  );
  const show = (/** @type {number[]} */ configuration) => {
    now = configuration;
    made.forEach((row, joint) => row.show(configuration[joint]));
  };
  return { rows: made.map(({ row }) => row), show };
}
