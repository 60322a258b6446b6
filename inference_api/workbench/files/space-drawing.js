// A scene in space on a canvas: faces and spheres, the farthest first.

/** @import {Matrix, SerialArm, Vector} from "./solid.js" */

import { around, dot, frames, looking, minus, moved } from "./solid.js";

const TARGET = /** @type {Vector} */ ([0.15, 0, 0.35]);
// Large faces are cut into pieces, so that the order of their middles is the order in which they hide each other.
const PIECE_M = 0.22;
const SIDES = 14;
const LIGHT = [0.35, -0.5, 0.79];

/**
 * @typedef {{pose: Matrix, half_m: number[]}} Box
 * @typedef {{pose: Matrix, radius_m: number, half_length_m: number}} Cylinder
 * @typedef {{points: Vector[], normal: number[]}} Face  The normal leads outwards.
 *
 * @typedef {object} Seen  What is drawn.
 * @property {Box[]} boxes
 * @property {Cylinder[]} cylinders
 * @property {{pose: Matrix}[]} cameras
 * @property {{configuration: number[], kind: "start" | "goal" | "moving"}[]} arms
 * @property {{configuration: number[], confidence: number, free: boolean | null}[]} samples
 * @property {number[][]} way
 */

export class SpaceDrawing {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.side = -0.6;
    this.up = 0.45;
    this.away = 3.1;
  }

  /** @param {SerialArm} arm @param {Seen} seen @param {Face[]} faces */
  draw(arm, seen, faces) {
    const { canvas } = this;
    const ratio = Math.min(2, devicePixelRatio || 1);
    const size = Math.round(canvas.clientWidth * ratio) || 480;
    if (canvas.width !== size) canvas.width = canvas.height = size;
    const context = canvas.getContext("2d");
    if (!context) return;
    const colours = palette(canvas);
    const eye = around(TARGET, this.side, this.up, this.away);
    const pose = looking(eye, TARGET);
    const focal = 1.05 * size;
    /** @param {Vector} point @returns {Vector} column, row, depth */
    const toPage = (point) => {
      const off = minus(point, eye);
      const [x, y, z] = [0, 1, 2].map((axis) => dot(off, [pose[0][axis], pose[1][axis], pose[2][axis]]));
      const depth = Math.max(0.05, z);
      return [size / 2 + (focal * x) / depth, size / 2 + (focal * y) / depth, z];
    };
    /** @type {{depth: number, paint: () => void}[]} */
    const items = [];
    for (const face of faces) {
      if (dot(face.normal, minus(eye, face.points[0])) > 0) items.push(this.face(context, face, toPage, colours));
    }
    for (const { configuration, kind } of seen.arms) {
      for (const [centre, radius] of spheres(arm, configuration)) {
        items.push(ball(context, toPage(centre), radius * focal, colours[kind], ratio));
      }
    }
    for (const sample of seen.samples) {
      const links = frames(arm, sample.configuration).map((frame) => toPage(/** @type {Vector} */ ([frame[0][3], frame[1][3], frame[2][3]])));
      items.push(ghost(context, links, sample, colours, ratio));
    }
    context.clearRect(0, 0, size, size);
    items.sort((a, b) => b.depth - a.depth).forEach((item) => item.paint());
    this.wires(context, arm, seen, toPage, colours, ratio);
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {Face} face
   * @param {(point: Vector) => Vector} toPage
   * @param {Record<string, string>} colours
   */
  face(context, face, toPage, colours) {
    const places = face.points.map(toPage);
    const depth = places.reduce((sum, place) => sum + place[2], 0) / places.length;
    return {
      depth,
      paint: () => {
        context.beginPath();
        places.forEach(([x, y]) => context.lineTo(x, y));
        context.closePath();
        context.fillStyle = `color-mix(in srgb, ${colours.body} ${Math.round(100 * shadeOf(face.normal))}%, ${colours.sheet})`;
        // What stands behind shines through.
        context.globalAlpha = 0.82;
        context.fill();
        context.globalAlpha = 1;
      },
    };
  }

  /**
   * The way of the tool, and the cameras.
   * @param {CanvasRenderingContext2D} context
   * @param {SerialArm} arm
   * @param {Seen} seen
   * @param {(point: Vector) => Vector} toPage
   * @param {Record<string, string>} colours
   * @param {number} ratio
   */
  wires(context, arm, seen, toPage, colours, ratio) {
    context.strokeStyle = colours.ink;
    context.lineWidth = 1.6 * ratio;
    context.beginPath();
    seen.way.forEach((configuration) => {
      const tool = frames(arm, configuration).at(-1) ?? [];
      const [x, y] = toPage([tool[0][3], tool[1][3], tool[2][3]]);
      context.lineTo(x, y);
    });
    context.stroke();
    context.strokeStyle = colours.accent;
    context.lineWidth = 1.2 * ratio;
    for (const { pose } of seen.cameras) {
      const [apex, ...corners] = [[0, 0, 0], [-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]].map((corner) =>
        toPage(moved(pose, corner.map((value) => 0.05 * value))),
      );
      context.beginPath();
      corners.forEach(([x, y], at) => {
        const [nextX, nextY] = corners[(at + 1) % 4];
        context.moveTo(apex[0], apex[1]);
        context.lineTo(x, y);
        context.lineTo(nextX, nextY);
      });
      context.stroke();
    }
  }
}

/**
 * Faces of all obstacles, cut into pieces.
 * @param {Box[]} boxes
 * @param {Cylinder[]} cylinders
 * @returns {Face[]}
 */
export function facesOf(boxes, cylinders) {
  return [...boxes.flatMap(boxFaces), ...cylinders.flatMap(cylinderFaces)];
}

/** @param {Box} box @returns {Face[]} */
function boxFaces({ pose, half_m: half }) {
  return [0, 1, 2].flatMap((axis) =>
    [-1, 1].flatMap((sign) => {
      const [first, second] = [(axis + 1) % 3, (axis + 2) % 3];
      const [rows, columns] = [first, second].map((one) => Math.min(12, Math.ceil((2 * half[one]) / PIECE_M)));
      /** @param {number} row @param {number} column */
      const corner = (row, column) => {
        const place = [0, 0, 0];
        place[axis] = sign * half[axis];
        place[first] = half[first] * ((2 * row) / rows - 1);
        place[second] = half[second] * ((2 * column) / columns - 1);
        return moved(pose, place);
      };
      const normal = [0, 1, 2].map((row) => sign * pose[row][axis]);
      return Array.from({ length: rows * columns }, (_, at) => {
        const [row, column] = [Math.floor(at / columns), at % columns];
        const points = [corner(row, column), corner(row + 1, column), corner(row + 1, column + 1), corner(row, column + 1)];
        return { points, normal };
      });
    }),
  );
}

/** @param {Cylinder} cylinder @returns {Face[]} */
function cylinderFaces({ pose, radius_m: radius, half_length_m: half }) {
  /** @param {number} at @param {number} sign */
  const rim = (at, sign) => {
    const angle = (2 * Math.PI * at) / SIDES;
    return moved(pose, [radius * Math.cos(angle), radius * Math.sin(angle), sign * half]);
  };
  const around = Array.from({ length: SIDES }, (_, at) => {
    const angle = (2 * Math.PI * (at + 0.5)) / SIDES;
    const normal = [0, 1, 2].map((row) => Math.cos(angle) * pose[row][0] + Math.sin(angle) * pose[row][1]);
    return { points: [rim(at, -1), rim(at + 1, -1), rim(at + 1, 1), rim(at, 1)], normal };
  });
  const ends = [-1, 1].map((sign) => ({
    points: Array.from({ length: SIDES }, (_, at) => rim(at, sign)),
    normal: [0, 1, 2].map((row) => sign * pose[row][2]),
  }));
  return [...around, ...ends];
}

/** @param {number[]} normal */
const shadeOf = (normal) => 0.68 - 0.32 * dot(normal, LIGHT);

/** @param {SerialArm} arm @param {number[]} configuration @returns {[Vector, number][]} */
function spheres(arm, configuration) {
  const links = frames(arm, configuration);
  return arm.parts.flatMap((part) =>
    part.spheres_m.map((sphere) => /** @type {[Vector, number]} */ ([moved(links[part.link], sphere), sphere[3]])),
  );
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Vector} place
 * @param {number} size
 * @param {string} colour
 * @param {number} ratio
 */
function ball(context, [x, y, depth], size, colour, ratio) {
  return {
    depth,
    paint: () => {
      context.beginPath();
      context.arc(x, y, Math.max(1, size / Math.max(0.05, depth)), 0, 2 * Math.PI);
      context.fillStyle = colour;
      context.fill();
      context.strokeStyle = "rgb(0 0 0 / 14%)";
      context.lineWidth = 0.6 * ratio;
      context.stroke();
    },
  };
}

/**
 * An arm that a sample stands for: its joints, and the tool by how sure the model is.
 * @param {CanvasRenderingContext2D} context
 * @param {Vector[]} links
 * @param {{confidence: number, free: boolean | null}} sample
 * @param {Record<string, string>} colours
 * @param {number} ratio
 */
function ghost(context, links, { confidence, free }, colours, ratio) {
  const [x, y, depth] = links[links.length - 1];
  return {
    depth,
    paint: () => {
      const colour = free === false ? colours.wrong : colours.accent;
      context.strokeStyle = colour;
      context.fillStyle = colour;
      context.lineWidth = 1.2 * ratio;
      context.globalAlpha = 0.1 + 0.15 * confidence;
      context.beginPath();
      links.forEach(([across, down]) => context.lineTo(across, down));
      context.stroke();
      context.globalAlpha = 0.2 + 0.8 * confidence;
      context.beginPath();
      context.arc(x, y, 3.2 * ratio, 0, 2 * Math.PI);
      if (confidence >= 0.5) context.fill();
      else context.stroke();
      context.globalAlpha = 1;
    },
  };
}

/** The page's colours, as they are now. @param {Element} element */
function palette(element) {
  const style = getComputedStyle(element);
  const named = (/** @type {string} */ name) => style.getPropertyValue(`--${name}`).trim();
  const [ink, accent, body, sheet, wrong, soft] = ["ink", "accent", "body", "sheet", "wrong", "soft"].map(named);
  return { ink, accent, body, sheet, wrong, start: soft, goal: `color-mix(in srgb, ${accent} 35%, ${sheet})`, moving: accent };
}
