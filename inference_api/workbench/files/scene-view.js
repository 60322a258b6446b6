// The plane: discs and arms, which can be dragged and moved by arrow keys.

/** @import {Camera, Configuration, Disc, End, Point, Robot} from "./geometry.js" */

import { degrees, jointPositions, pointedAt } from "./geometry.js";
import { ENDS, SIDE, STEP_RAD, arrow, draggable, draw, set } from "./svg.js";

const STEP_M = 0.1;
// The later ones lie over the earlier.
const ARMS = /** @type {const} */ (["ghost", "peek", "start", "goal", "least", "moving"]);

/**
 * @typedef {object} Shown
 * @property {Disc[]} discs
 * @property {number} chosen  Which disc; -1 for none.
 * @property {Configuration} start
 * @property {Configuration} goal
 * @property {Configuration[]} ghost  Along the path.
 * @property {Configuration | null} moving  The arm on its path.
 * @property {Configuration | null} least  Where the path has its lowest confidence.
 * @property {Configuration | null} peek  Where the pointer is in the joint space.
 * @property {string | null} picture  Base64 of a PNG that is shown instead of discs.
 *
 * @typedef {object} Changes
 * @property {(at: number, disc: Disc, byKey: boolean) => void} disc
 * @property {(at: number) => void} choose
 * @property {(at: number) => void} remove
 * @property {(end: End, configuration: Configuration) => void} end
 */

export class SceneView {
  /** @param {SVGSVGElement} drawing @param {Robot} robot @param {Camera} camera @param {Changes} changes */
  constructor(drawing, robot, camera, changes) {
    this.drawing = drawing;
    this.robot = robot;
    this.camera = camera;
    this.changes = changes;
    /** @type {Shown | null} */
    this.shown = null;
    /** @type {SVGCircleElement[]} */
    this.discs = [];
    /** Pixels of the drawing for a metre. */
    this.scale = SIDE / (camera.right - camera.left);
    this.picture = draw("image", { width: SIDE, height: SIDE, class: "shown", preserveAspectRatio: "none" });
    this.layers = { discs: draw("g"), arms: draw("g"), handles: draw("g") };
    drawing.replaceChildren(this.grid(), this.picture, ...Object.values(this.layers));
    const width = Math.max(2.5, 2 * robot.halfWidth * this.scale);
    this.arms = ARMS.map((kind) => draw("path", { class: `arm ${kind}`, "stroke-width": width, "aria-hidden": "true" }));
    this.handles = ENDS.map((end) => robot.links.map((_, joint) => this.makeHandle(end, joint)));
    const base = this.toDrawing({ x: 0, y: 0 });
    this.layers.arms.append(...this.arms, draw("circle", { class: "base", cx: base.x, cy: base.y, r: 5 }));
  }

  /** @param {Point} place @returns {Point} */
  toDrawing({ x, y }) {
    return { x: (x - this.camera.left) * this.scale, y: (this.camera.top - y) * this.scale };
  }

  /** @param {Point} place @returns {Point} */
  toMetres({ x, y }) {
    return { x: x / this.scale + this.camera.left, y: this.camera.top - y / this.scale };
  }

  /** @param {Shown} shown */
  show(shown) {
    this.shown = shown;
    this.showDiscs(shown);
    ARMS.forEach((kind, row) => {
      const arms = kind === "ghost" ? shown.ghost : [shown[kind] ?? []];
      this.arms[row].setAttribute("d", arms.map((one) => this.outline(one)).join(""));
    });
    ENDS.forEach((end, row) => {
      const places = jointPositions(this.robot, shown[end]).slice(1).map((place) => this.toDrawing(place));
      this.handles[row].forEach((handle, joint) => {
        const angle = shown[end][joint];
        const now = { "aria-valuenow": Math.round((angle * 180) / Math.PI), "aria-valuetext": degrees(angle) };
        set(handle, { cx: places[joint].x, cy: places[joint].y, ...now });
      });
    });
    const source = `data:image/png;base64,${shown.picture}`;
    if (shown.picture && this.picture.getAttribute("href") !== source) this.picture.setAttribute("href", source);
    this.picture.toggleAttribute("hidden", !shown.picture);
    this.layers.discs.toggleAttribute("hidden", Boolean(shown.picture));
  }

  grid() {
    const group = draw("g", { "aria-hidden": "true" });
    group.append(draw("rect", { class: "frame", width: SIDE, height: SIDE }));
    for (let at = Math.ceil(this.camera.left); at <= this.camera.right; at += 1) {
      const x = this.toDrawing({ x: at, y: 0 }).x;
      group.append(draw("path", { class: "grid", d: `M${x} 0V${SIDE}M0 ${x}H${SIDE}` }));
    }
    return group;
  }

  /** Nothing for no configuration. @param {Configuration} configuration */
  outline(configuration) {
    if (!configuration.length) return "";
    const places = jointPositions(this.robot, configuration).map((place) => this.toDrawing(place));
    return `M${places.map(({ x, y }) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L")}`;
  }

  /** @param {End} end @param {number} joint */
  makeHandle(end, joint) {
    const [low, high] = [this.robot.low, this.robot.high].map((limits) => Math.round((limits[joint] * 180) / Math.PI));
    const words = { "aria-label": `${end === "start" ? "Start" : "Goal"}, joint ${joint + 1}`, "aria-valuemin": low, "aria-valuemax": high };
    const handle = draw("circle", { class: `handle ${end}`, r: 7, tabindex: 0, role: "slider", ...words });
    this.layers.handles.append(handle);
    const turn = (/** @type {(configuration: Configuration) => number} */ angle) => {
      if (this.shown) this.changes.end(end, this.shown[end].with(joint, angle(this.shown[end])));
    };
    draggable(handle, this.drawing, (place) => turn((now) => pointedAt(this.robot, now, joint, this.toMetres(place))));
    handle.addEventListener("keydown", (event) => {
      const step = arrow(event);
      if (step) turn((now) => now[joint] + STEP_RAD * (step[0] + step[1]));
    });
    return handle;
  }

  /** @param {Shown} shown */
  showDiscs(shown) {
    while (this.discs.length > shown.discs.length) this.discs.pop()?.remove();
    while (this.discs.length < shown.discs.length) this.discs.push(this.makeDisc(this.discs.length));
    shown.discs.forEach((disc, at) => {
      const { x, y } = this.toDrawing(disc);
      const words = `Disc ${at + 1} at x ${disc.x.toFixed(1)} m, y ${disc.y.toFixed(1)} m, radius ${disc.r.toFixed(2)} m`;
      const chosen = at === shown.chosen;
      set(this.discs[at], { cx: x, cy: y, r: disc.r * this.scale, "aria-label": words, "aria-pressed": String(chosen) });
      this.discs[at].classList.toggle("chosen", chosen);
    });
  }

  /** @param {number} at */
  makeDisc(at) {
    const circle = draw("circle", { class: "disc", tabindex: 0, role: "button", "aria-roledescription": "disc" });
    this.layers.discs.append(circle);
    let [offX, offY] = [0, 0];
    draggable(circle, this.drawing, (place, first) => {
      const disc = this.shown?.discs[at];
      if (!disc) return;
      const { x, y } = this.toMetres(place);
      if (first) {
        [offX, offY] = [disc.x - x, disc.y - y];
        this.changes.choose(at);
      } else this.changes.disc(at, { ...disc, x: x + offX, y: y + offY }, false);
    });
    circle.addEventListener("focus", () => this.changes.choose(at));
    circle.addEventListener("keydown", (event) => this.pressed(event, at));
    return circle;
  }

  /** @param {KeyboardEvent} event @param {number} at */
  pressed(event, at) {
    const disc = this.shown?.discs[at];
    if (!disc) return;
    const step = arrow(event);
    if (step) this.changes.disc(at, { ...disc, x: disc.x + STEP_M * step[0], y: disc.y + STEP_M * step[1] }, true);
    else if (event.key === "Delete" || event.key === "Backspace") this.changes.remove(at);
    else if (event.key === "+") this.changes.disc(at, { ...disc, r: disc.r + 0.05 }, true);
    else if (event.key === "-") this.changes.disc(at, { ...disc, r: disc.r - 0.05 }, true);
    else return;
    event.preventDefault();
  }

  /** @param {number} at */
  focusDisc(at) {
    this.discs[at]?.focus();
  }
}
