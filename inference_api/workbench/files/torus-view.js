// The joint space: joint 1 across and joint 2 up, with what collides, samples, start, goal and path.

/** @import {Configuration, End, Robot} from "./geometry.js" */

import { degrees, difference } from "./geometry.js";
import { ENDS, SIDE, STEP_RAD, arrow, draggable, draw, placeIn, set } from "./svg.js";

// Lower ends of the classes of confidence; what is below the first has a class of its own.
const CLASSES = [0.5, 0.9, 0.99];

/**
 * @typedef {object} Ground  What lies under the samples.
 * @property {number} cells  Along each axis.
 * @property {(first: number, second: number) => number} level  Of a cell: 0 for free, to 3 for taken.
 *
 * @typedef {object} Drawn
 * @property {Configuration[]} samples
 * @property {number[] | null} confidence
 * @property {boolean[] | null} free  In truth.
 * @property {Ground | null} ground
 *
 * @typedef {object} Ends
 * @property {Configuration} start
 * @property {Configuration} goal
 * @property {Configuration[]} path
 * @property {Configuration | null} moving
 * @property {number[]} edges  The least confidence on each edge of the path.
 * @property {Configuration | null} least  Where the confidence is lowest.
 *
 * @typedef {{nodes?: Configuration[], parents?: number[]}} Planted  The parent of each node; -1 for roots.
 *
 * @typedef {object} EndChanges
 * @property {(end: End, configuration: Configuration) => void} end
 * @property {(first: number, second: number) => void} click  Angles in rad.
 * @property {(first: number | null, second: number) => void} peek
 */

export class TorusView {
  /**
   * @param {SVGSVGElement} drawing
   * @param {Robot} robot
   * @param {EndChanges} changes
   */
  constructor(drawing, robot, changes) {
    this.drawing = drawing;
    this.robot = robot;
    this.changes = changes;
    /** @type {Ends | null} */
    this.ends = null;
    /** @type {Ground | null} */
    this.ground = null;
    this.grounds = [1, 2, 3].map((level) => draw("path", { class: `ground ground-${level}` }));
    this.dots = [0, 1, 2, 3].map((place) => draw("path", { class: `dots dots-${place}` }));
    this.crosses = draw("path", { class: "crosses" });
    this.tree = draw("path", { class: "tree" });
    /** Whose tree that is. @type {Planted | null} */
    this.planted = null;
    this.path = draw("path", { class: "path" });
    this.uncertain = draw("path", { class: "uncertain" });
    this.least = draw("circle", { class: "least", r: 8 });
    this.now = draw("circle", { class: "now", r: 5 });
    const plot = draw("rect", { class: "plot", width: SIDE, height: SIDE });
    const inside = draw("g", { "clip-path": `url(#${drawing.id}-clip)`, "aria-hidden": "true" });
    inside.append(...this.grounds, ...this.dots, this.crosses, this.tree, this.path, this.uncertain, this.least, this.now);
    this.marks = ENDS.map((end) => this.makeMark(end));
    const marks = draw("g");
    marks.append(...this.marks.flatMap(({ mark, letter }) => [mark, letter]));
    drawing.replaceChildren(this.frame(), inside, plot, marks);
    this.listen(plot);
  }

  /** @param {number} joint @param {number} angle */
  toDrawing(joint, angle) {
    const { low, high } = this.robot;
    const share = (angle - low[joint]) / (high[joint] - low[joint]);
    return joint === 0 ? share * SIDE : (1 - share) * SIDE;
  }

  /** @param {{x: number, y: number}} place @returns {[number, number]} */
  toAngles(place) {
    const { low, high } = this.robot;
    const [first, second] = [place.x / SIDE, 1 - place.y / SIDE];
    return [low[0] + first * (high[0] - low[0]), low[1] + second * (high[1] - low[1])];
  }

  frame() {
    const group = draw("g", { "aria-hidden": "true" });
    const clip = draw("clipPath", { id: `${this.drawing.id}-clip` });
    clip.append(draw("rect", { width: SIDE, height: SIDE }));
    group.append(clip, draw("rect", { class: "frame", width: SIDE, height: SIDE }));
    for (const joint of [0, 1]) {
      for (const share of [0, 0.25, 0.5, 0.75, 1]) {
        const angle = this.robot.low[joint] + share * (this.robot.high[joint] - this.robot.low[joint]);
        const at = this.toDrawing(joint, angle);
        const line = joint === 0 ? `M${at} 0V${SIDE}` : `M0 ${at}H${SIDE}`;
        if (share > 0 && share < 1) group.append(draw("path", { class: "grid", d: line }));
        if (share === 0.25 || share === 0.75) continue;
        const where = joint === 0 ? { x: at, y: SIDE + 17 } : { x: -7, y: at + 4 };
        const anchor = joint === 1 ? "end" : share === 0 ? "start" : share === 1 ? "end" : "middle";
        const text = draw("text", { class: "tick", "text-anchor": anchor, ...where });
        text.textContent = tick(angle);
        if (joint === 1 && share === 1) text.setAttribute("y", String(at + 11));
        if (joint === 1 && share === 0) text.setAttribute("y", String(at - 2));
        group.append(text);
      }
    }
    return group;
  }

  /** @param {End} end */
  makeMark(end) {
    /** @type {SVGElement} */
    const mark =
      end === "start"
        ? draw("circle", { r: 9 })
        : draw("rect", { x: -8.5, y: -8.5, width: 17, height: 17, rx: 3 });
    set(mark, { class: `mark ${end}`, tabindex: 0, role: "button", "aria-roledescription": "configuration" });
    const letter = draw("text", { class: "letter", "aria-hidden": "true", dy: 4 });
    letter.textContent = end === "start" ? "S" : "G";
    draggable(mark, this.drawing, (place, first) => {
      if (!first) this.move(end, this.toAngles(place));
    });
    mark.addEventListener("keydown", (event) => {
      const step = arrow(event);
      if (!step || !this.ends) return;
      const [first, second] = this.ends[end];
      this.move(end, [first + STEP_RAD * step[0], second + STEP_RAD * step[1]]);
    });
    return { mark, letter };
  }

  /** @param {End} end @param {[number, number]} angles */
  move(end, angles) {
    if (this.ends) this.changes.end(end, [...angles, ...this.ends[end].slice(2)]);
  }

  /** @param {SVGRectElement} plot */
  listen(plot) {
    plot.addEventListener("pointermove", (event) => {
      if (event.pointerType === "mouse") this.changes.peek(...this.toAngles(placeIn(this.drawing, event)));
    });
    plot.addEventListener("pointerleave", () => this.changes.peek(null, 0));
    plot.addEventListener("click", (event) => {
      this.changes.click(...this.toAngles(placeIn(this.drawing, /** @type {PointerEvent} */ (event))));
    });
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

  /** Branches of what was planned, drawn again only where it is another. @param {Planted | null} planted */
  showTree(planted) {
    if (planted === this.planted) return;
    this.planted = planted;
    const { nodes = [], parents = [] } = planted ?? {};
    const branches = nodes.map((node, at) => (parents[at] < 0 ? "" : this.line([nodes[parents[at]], node])));
    this.tree.setAttribute("d", branches.join(""));
  }

  /** @param {SVGCircleElement} circle @param {Configuration | null} configuration */
  place(circle, configuration) {
    circle.toggleAttribute("hidden", !configuration);
    if (configuration) set(circle, { cx: this.toDrawing(0, configuration[0]), cy: this.toDrawing(1, configuration[1]) });
  }

  /**
   * A path on the map: a piece that crosses a seam is drawn at both sides of it.
   * @param {Configuration[]} path
   * @param {(at: number) => boolean} [wanted]  Which edges.
   */
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

  /** @param {Drawn} drawn */
  show(drawn) {
    const places = drawn.samples.map((one) => [this.toDrawing(0, one[0]), this.toDrawing(1, one[1])]);
    const dots = this.dots.map(() => "");
    let crosses = "";
    places.forEach(([x, y], at) => {
      const confidence = drawn.confidence ? drawn.confidence[at] : 1;
      const place = levelOf(confidence);
      if (drawn.free && !drawn.free[at]) crosses += `M${(x - 4).toFixed(1)} ${(y - 4).toFixed(1)}l8 8m-8 0l8-8`;
      else dots[place] += `M${x.toFixed(1)} ${y.toFixed(1)}h0`;
    });
    this.dots.forEach((path, place) => path.setAttribute("d", dots[place]));
    this.crosses.setAttribute("d", crosses);
    this.showGround(drawn.ground);
  }

  /** Drawn again only where it is another one: it is most of the work. @param {Ground | null} ground */
  showGround(ground) {
    if (ground === this.ground) return;
    this.ground = ground;
    const paths = this.grounds.map(() => "");
    for (let first = 0; ground && first < ground.cells; first += 1) {
      const [left, right] = [first, first + 1].map((at) => (at * SIDE) / ground.cells);
      for (let from = 0; from < ground.cells; ) {
        const level = ground.level(first, from);
        let to = from + 1;
        while (to < ground.cells && ground.level(first, to) === level) to += 1;
        const [low, high] = [from, to].map((at) => SIDE - (at * SIDE) / ground.cells);
        if (level > 0) paths[level - 1] += `M${left} ${low}H${right}V${high}H${left}z`;
        from = to;
      }
    }
    this.grounds.forEach((path, level) => path.setAttribute("d", paths[level]));
  }
}

/** The class of a confidence, 0 to 3. @param {number} confidence */
const levelOf = (confidence) => CLASSES.filter((low) => confidence >= low).length;

/** @param {number} angle */
function tick(angle) {
  if (Math.abs(Math.abs(angle) - Math.PI) < 1e-6) return angle < 0 ? "−π" : "π";
  return Math.abs(angle) < 1e-9 ? "0" : degrees(angle);
}
