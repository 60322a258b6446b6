// The joint space: joint 1 across and joint 2 up, with what collides, samples, start, goal and path.

/** @import {Configuration, End, Robot} from "./geometry.js" */

import { degrees, difference } from "./geometry.js";
import { ENDS, SIDE, STEP_RAD, arrow, draggable, draw, placeIn, set } from "./svg.js";

// Lower ends of the classes of confidence above the lowest one.
const CLASSES = [0.5, 0.9, 0.99];

/**
 * @typedef {object} Ground  What lies under the samples.
 * @property {number} cells  Along each axis.
 * @property {(first: number, second: number) => number} level  Of a cell: 0 for free, to 3 for taken.
 *
 * @typedef {object} Ends
 * @property {Configuration} start
 * @property {Configuration} goal
 * @property {Configuration[]} path
 * @property {Configuration | null} moving
 * @property {number[]} edges  The lowest confidence on each edge of the path.
 * @property {Configuration | null} least  Where the confidence is lowest.
 *
 * @typedef {object} EndChanges
 * @property {(end: End, configuration: Configuration) => void} end
 * @property {(first: number, second: number) => void} click  Angles in rad.
 * @property {(first: number | null, second: number) => void} peek
 */

export class TorusView {
  /** @param {SVGSVGElement} drawing @param {Robot} robot @param {EndChanges} changes */
  constructor(drawing, robot, changes) {
    this.drawing = drawing;
    this.robot = robot;
    this.changes = changes;
    /** @type {Ends | null} */
    this.ends = null;
    /** @type {Ground | null} */
    this.ground = null;
    this.grounds = [1, 2, 3].map((level) => draw("path", { class: `ground ground-${level}` }));
    this.dots = [0, 1, 2, 3].map((level) => draw("path", { class: `dots dots-${level}` }));
    this.crosses = draw("path", { class: "crosses" });
    this.path = draw("path", { class: "path" });
    this.uncertain = draw("path", { class: "uncertain" });
    this.least = draw("circle", { class: "least", r: 8 });
    this.now = draw("circle", { class: "now", r: 5 });
    const plot = draw("rect", { class: "plot", width: SIDE, height: SIDE });
    const inside = draw("g", { "clip-path": "url(#torus-clip)", "aria-hidden": "true" });
    inside.append(...this.grounds, ...this.dots, this.crosses, this.path, this.uncertain, this.least, this.now);
    this.marks = ENDS.map((end) => this.makeMark(end));
    drawing.replaceChildren(this.frame(), inside, plot, ...this.marks.flatMap(({ mark, letter }) => [mark, letter]));
    plot.addEventListener("pointermove", (event) => {
      if (event.pointerType === "mouse") changes.peek(...this.toAngles(placeIn(drawing, event)));
    });
    plot.addEventListener("pointerleave", () => changes.peek(null, 0));
    plot.addEventListener("click", (event) => changes.click(...this.toAngles(placeIn(drawing, event))));
  }

  /** @param {number} joint @param {number} angle */
  toDrawing(joint, angle) {
    const { low, high } = this.robot;
    const share = (angle - low[joint]) / (high[joint] - low[joint]);
    return joint === 0 ? share * SIDE : (1 - share) * SIDE;
  }

  /** @param {{x: number, y: number}} place @returns {[number, number]} */
  toAngles({ x, y }) {
    const { low, high } = this.robot;
    return [low[0] + (x / SIDE) * (high[0] - low[0]), low[1] + (1 - y / SIDE) * (high[1] - low[1])];
  }

  frame() {
    const group = draw("g", { "aria-hidden": "true" });
    const clip = draw("clipPath", { id: "torus-clip" });
    clip.append(draw("rect", { width: SIDE, height: SIDE }));
    group.append(clip, draw("rect", { class: "frame", width: SIDE, height: SIDE }));
    const { low, high } = this.robot;
    for (const share of [0.25, 0.5, 0.75]) {
      group.append(draw("path", { class: "grid", d: `M${share * SIDE} 0V${SIDE}M0 ${share * SIDE}H${SIDE}` }));
    }
    ["start", "middle", "end"].forEach((anchor, at) => {
      const across = { x: (at * SIDE) / 2, y: SIDE + 17, "text-anchor": anchor };
      const up = { x: -7, y: SIDE - (at * SIDE) / 2 + [-2, 4, 11][at], "text-anchor": "end" };
      [across, up].forEach((where, joint) => {
        const text = draw("text", { class: "tick", ...where });
        text.textContent = tick(low[joint] + (at / 2) * (high[joint] - low[joint]));
        group.append(text);
      });
    });
    return group;
  }

  /** @param {End} end */
  makeMark(end) {
    const square = { x: -8.5, y: -8.5, width: 17, height: 17, rx: 3 };
    /** @type {SVGElement} */
    const mark = end === "start" ? draw("circle", { r: 9 }) : draw("rect", square);
    set(mark, { class: `mark ${end}`, tabindex: 0, role: "button", "aria-roledescription": "configuration" });
    const letter = draw("text", { class: "letter", "aria-hidden": "true", dy: 4 });
    letter.textContent = end === "start" ? "S" : "G";
    const move = (/** @type {Configuration} */ angles) => {
      if (this.ends) this.changes.end(end, [...angles, ...this.ends[end].slice(2)]);
    };
    draggable(mark, this.drawing, (place, first) => {
      if (!first) move(this.toAngles(place));
    });
    mark.addEventListener("keydown", (event) => {
      const step = arrow(event);
      const [first, second] = this.ends?.[end] ?? [];
      if (step) move([first + STEP_RAD * step[0], second + STEP_RAD * step[1]]);
    });
    return { mark, letter };
  }

  /** @param {Ends} ends */
  showEnds(ends) {
    this.ends = ends;
    ENDS.forEach((end, row) => {
      const [x, y] = [this.toDrawing(0, ends[end][0]), this.toDrawing(1, ends[end][1])];
      const angles = ends[end].map((angle, joint) => `joint ${joint + 1} ${degrees(angle)}`).join(", ");
      set(this.marks[row].mark, {
        transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})`,
        "aria-label": `${end === "start" ? "Start" : "Goal"}: ${angles}`,
      });
      set(this.marks[row].letter, { x, y });
    });
    this.path.setAttribute("d", this.line(ends.path));
    this.uncertain.setAttribute("d", this.line(ends.path, (at) => ends.edges[at] < CLASSES[1]));
    this.place(this.now, ends.moving);
    this.place(this.least, ends.least);
  }

  /** @param {SVGCircleElement} circle @param {Configuration | null} configuration */
  place(circle, configuration) {
    circle.toggleAttribute("hidden", !configuration);
    if (configuration) set(circle, { cx: this.toDrawing(0, configuration[0]), cy: this.toDrawing(1, configuration[1]) });
  }

  /** A path on the map; an edge that wraps is drawn at both sides. @param {Configuration[]} path @param {(at: number) => boolean} [wanted]  Which edges. */
  line(path, wanted = () => true) {
    let lines = "";
    for (let at = 0; at + 1 < path.length; at += 1) {
      if (!wanted(at)) continue;
      const [from, to] = [path[at], path[at + 1]];
      const step = difference(this.robot, from, to);
      lines += this.piece(from, from.map((angle, joint) => angle + step[joint]));
      if (step.some((value, joint) => Math.abs(from[joint] + value - to[joint]) > 1e-6)) {
        lines += this.piece(to.map((angle, joint) => angle - step[joint]), to);
      }
    }
    return lines;
  }

  /** @param {Configuration} from @param {Configuration} to */
  piece(from, to) {
    const [a, b] = [from, to].map((one) => [0, 1].map((joint) => this.toDrawing(joint, one[joint]).toFixed(1)));
    return `M${a.join(" ")}L${b.join(" ")}`;
  }

  /** @param {{samples: Configuration[], confidence: number[] | null, free: boolean[] | null, ground: Ground | null}} shown */
  show({ samples, confidence, free, ground }) {
    const dots = this.dots.map(() => "");
    let crosses = "";
    samples.forEach((sample, at) => {
      const [x, y] = [0, 1].map((joint) => this.toDrawing(joint, sample[joint]));
      const level = CLASSES.filter((low) => (confidence?.[at] ?? 1) >= low).length;
      if (free && !free[at]) crosses += `M${(x - 4).toFixed(1)} ${(y - 4).toFixed(1)}l8 8m-8 0l8-8`;
      else dots[level] += `M${x.toFixed(1)} ${y.toFixed(1)}h0`;
    });
    this.dots.forEach((path, level) => path.setAttribute("d", dots[level]));
    this.crosses.setAttribute("d", crosses);
    this.showGround(ground);
  }

  /** Drawn only when it changes, because it takes most of the time. @param {Ground | null} ground */
  showGround(ground) {
    if (ground === this.ground) return;
    this.ground = ground;
    const paths = this.grounds.map(() => "");
    for (let first = 0; ground && first < ground.cells; first += 1) {
      const [left, right] = [first, first + 1].map((at) => (at * SIDE) / ground.cells);
      for (let from = 0, to = 0; from < ground.cells; from = to) {
        const level = ground.level(first, from);
        while (to < ground.cells && ground.level(first, to) === level) to += 1;
        const [low, high] = [from, to].map((at) => SIDE - (at * SIDE) / ground.cells);
        if (level > 0) paths[level - 1] += `M${left} ${low}H${right}V${high}H${left}z`;
      }
    }
    this.grounds.forEach((path, level) => path.setAttribute("d", paths[level]));
  }
}

/** @param {number} angle */
function tick(angle) {
  if (Math.abs(Math.abs(angle) - Math.PI) < 1e-6) return angle < 0 ? "−π" : "π";
  return degrees(angle);
}
