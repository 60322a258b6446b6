// Everything beside the drawings: fields, buttons, dropped pictures.

/** @import {Disc} from "./geometry.js" */
/** @import {Workbench} from "./main.js" */

import { speak } from "./messages.js";
import { MAX_DISCS, clamp, isSeed } from "./state.js";
import { buttonOf, byId, inputOf, selectOf } from "./svg.js";

/** Fields of numbers: id, name in the state, least, most, whether whole. */
const NUMBERS = /** @type {const} */ ([
  ["count", "n", 1, 2000, true],
  ["plan-limit", "limit", 0.01, 10, false],
  ["plan-paths", "paths", 1, 64, true],
]);
const CONFIDENCES = /** @type {const} */ ([["confidence", "confidence"], ["plan-min-confidence", "minConfidence"]]);
const SEEDS = /** @type {const} */ ([["seed", "seed"], ["plan-seed", "planSeed"]]);
const NEW_DISCS = [[2.4, -1.8], [-1.8, -2.4], [0, 3], [3, 0], [-3, 0]];
const RADIUS = { least: 0.2, most: 2.5 };
// The API takes bodies of 8 MiB, and base64 makes four letters of three bytes.
const MAX_FILE = 5 * 1024 * 1024;

export class Controls {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    this.select = selectOf("model");
    this.radius = inputOf("radius");
    this.listen();
    this.listenToFiles();
  }

  listen() {
    const { bench } = this;
    this.select.addEventListener("change", () => bench.choose(this.select.value));
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
    const ground = selectOf("ground");
    ground.addEventListener("change", () => {
      bench.shown.ground = null;
      bench.change({ ground: /** @type {"truth" | "prediction" | "none"} */ (ground.value) });
    });
  }

  listenToFiles() {
    const open = inputOf("open");
    open.addEventListener("change", () => {
      void this.openPicture(open.files?.[0]);
      // The same file again is a change, too.
      open.value = "";
    });
    // The browser would open a file that is dropped beside the page's fields.
    addEventListener("dragover", (event) => event.preventDefault());
    addEventListener("drop", (event) => {
      event.preventDefault();
      void this.openPicture(event.dataTransfer?.files[0]);
    });
    byId("back").addEventListener("click", () => this.bench.change({ picture: null }));
  }

  /** @param {File | undefined} file */
  async openPicture(file) {
    if (!file) return;
    if (file.size > MAX_FILE) {
      const detail = `${file.name} has more than 5 MiB; expected a PNG of 16 to 2048 pixels a side`;
      return this.bench.messages.show({ title: "The file is too large", detail });
    }
    let text = "";
    for (const byte of new Uint8Array(await file.arrayBuffer())) text += String.fromCharCode(byte);
    this.bench.change({ picture: btoa(text) });
  }

  /** The server has reported what it has. */
  ready() {
    const { models, truth, state } = this.bench;
    const options = models.map(
      ({ reference, aliases }) => new Option(`${reference}${aliases.length ? ` (${aliases.join(", ")})` : ""}`, reference),
    );
    if (state.model && !options.some(({ value }) => value === state.model)) options.push(new Option(state.model, state.model));
    this.select.replaceChildren(new Option("default", ""), ...options);
    const known = selectOf("ground").options[0];
    known.disabled = !truth;
    known.textContent = `collisions (ground truth${truth ? "" : ": off on this server"})`;
    byId("no-scenes").hidden = truth;
  }

  /** Fields follow the state. */
  show() {
    const { state, chosen } = this.bench;
    const disc = state.picture ? undefined : state.discs[chosen];
    byId("disc-status", HTMLOutputElement).textContent = disc
      ? `disc ${chosen + 1}: x ${disc.x.toFixed(2)}, y ${disc.y.toFixed(2)}, r ${disc.r.toFixed(2)} m`
      : state.picture ? "dropped picture, no discs" : "no disc selected";
    buttonOf("remove-disc").disabled = this.radius.disabled = !disc;
    buttonOf("add-disc").disabled = Boolean(state.picture) || state.discs.length >= MAX_DISCS;
    if (disc) this.radius.value = String(disc.r);
    for (const [id, name] of [...NUMBERS, ...SEEDS]) {
      // Leave a field alone in which somebody is writing.
      if (document.activeElement !== inputOf(id)) inputOf(id).value = String(state[name]);
    }
    for (const [id, name] of CONFIDENCES) {
      offerConfidence(selectOf(id), String(state[name] ?? ""));
      selectOf(id).value = String(state[name] ?? "");
    }
    selectOf("ground").value = state.ground;
    this.select.value = state.model;
    byId("back").hidden = !state.picture;
  }

  /** @param {string | null} image  Base64 of a PNG. */
  showPicture(image) {
    const picture = byId("picture", HTMLImageElement);
    const source = `data:image/png;base64,${image}`;
    picture.hidden = !image;
    if (image && picture.src !== source) byId("save", HTMLAnchorElement).href = picture.src = source;
  }

  addDisc() {
    const { bench } = this;
    const { discs } = bench.state;
    const [x, y] = NEW_DISCS[discs.length % NEW_DISCS.length];
    bench.chosen = discs.length;
    bench.change({ discs: [...discs, { x, y, r: 1 }] });
    speak(`Disc ${bench.chosen + 1} added`);
    requestAnimationFrame(() => bench.sceneView?.focusDisc(bench.chosen));
  }

  /** @param {number} at */
  removeDisc(at) {
    const { bench } = this;
    if (!bench.state.discs[at]) return;
    bench.chosen = -1;
    bench.change({ discs: bench.state.discs.filter((_, place) => place !== at) });
    speak(`Disc ${at + 1} removed`);
    const { length } = bench.state.discs;
    requestAnimationFrame(() => (length ? bench.sceneView?.focusDisc(Math.min(at, length - 1)) : buttonOf("add-disc").focus()));
  }

  /** @param {number} at @param {Disc} disc @param {boolean} [byKey]  Spoken then. */
  moveDisc(at, disc, byKey = false) {
    const { camera, state } = this.bench;
    if (!camera) return;
    const moved = {
      x: Math.min(camera.right, Math.max(camera.left, disc.x)),
      y: Math.min(camera.top, Math.max(camera.bottom, disc.y)),
      r: Math.min(RADIUS.most, Math.max(RADIUS.least, disc.r)),
    };
    this.bench.change({ discs: state.discs.map((one, place) => (place === at ? moved : one)) });
    if (byKey) speak(`Disc ${at + 1}: x ${moved.x.toFixed(1)}, y ${moved.y.toFixed(1)}, radius ${moved.r.toFixed(2)}`);
  }

  /** A click into the joint space. @param {number} first @param {number} second */
  clicked(first, second) {
    const end = inputOf("end-start").checked ? "start" : "goal";
    this.bench.moveEnd(end, [first, second, ...this.bench.state[end].slice(2)]);
  }
}

/** Add a choice unless it is there. @param {HTMLSelectElement} select @param {string} text  Empty for none. */
function offerConfidence(select, text) {
  if ([...select.options].some((option) => option.value === text)) return;
  select.append(new Option(text === "0" ? "any" : text || "model default", text));
}
