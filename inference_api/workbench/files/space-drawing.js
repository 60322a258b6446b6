// A scene in space on a canvas: faces and spheres, the farthest first.

/** @import {Matrix, SerialArm, Vector} from "./solid.js" */

import { around, dot, frames, looking, minus, moved } from "./solid.js";

const TARGET = /** @type {Vector} */ ([0.15, 0, 0.35]);
const LIGHT = [0.35, -0.5, 0.79];

/**
 * @typedef {{points: Vector[], normal: number[]}} Face  Of an obstacle; the normal leads outwards.
 *
 * @typedef {object} Seen  What is drawn.
 * @property {Face[]} faces
 * @property {{pose: Matrix}[]} cameras
 * @property {{configuration: number[], kind: "start" | "goal" | "moving"}[]} arms
 * @property {{configuration: number[], confidence: number, free: boolean | null}[]} samples
 * @property {number[][]} way
 *
 * @typedef {object} Sheet  What is drawn on, and how.
 * @property {CanvasRenderingContext2D} context
 * @property {(point: Vector) => Vector} toPage  Column, row, depth.
 * @property {number} focal  Pixels of a metre at a metre.
 * @property {Record<string, string>} colours
 * @property {number} ratio  Pixels of the canvas for one of the page.
 *
 * @typedef {{depth: number, paint: () => void}} Item  The farthest are painted first.
 */

export class SpaceDrawing {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.side = -0.6;
    this.up = 0.45;
    this.away = 3.1;
  }

  /** @param {SerialArm} arm @param {Seen} seen */
  draw(arm, seen) {
    const { canvas } = this;
    const ratio = Math.min(2, devicePixelRatio || 1);
    const size = Math.round(canvas.clientWidth * ratio) || 480;
    if (canvas.width !== size) canvas.width = canvas.height = size;
    const context = canvas.getContext("2d");
    if (!context) return;
    const eye = around(TARGET, this.side, this.up, this.away);
    const pose = looking(eye, TARGET);
    const focal = 1.05 * size;
    /** @param {Vector} point @returns {Vector} */
    const toPage = (point) => {
      const off = minus(point, eye);
      const [x, y, z] = [0, 1, 2].map((axis) => dot(off, [pose[0][axis], pose[1][axis], pose[2][axis]]));
      const depth = Math.max(0.05, z);
      return [size / 2 + (focal * x) / depth, size / 2 + (focal * y) / depth, z];
    };
    const sheet = { context, toPage, focal, colours: palette(canvas), ratio };
    const items = seen.faces.filter(({ normal, points }) => dot(normal, minus(eye, points[0])) > 0).map((one) => plate(sheet, one));
    for (const { configuration, kind } of seen.arms) {
      items.push(...spheres(arm, configuration).map(([centre, radius]) => ball(sheet, centre, radius, kind)));
    }
    items.push(...seen.samples.map((sample) => ghost(sheet, arm, sample)));
    context.clearRect(0, 0, size, size);
    items.sort((a, b) => b.depth - a.depth).forEach((item) => item.paint());
    wires(sheet, arm, seen);
  }
}

/** A piece of an obstacle. @param {Sheet} sheet @param {Face} face @returns {Item} */
function plate({ context, toPage, colours }, face) {
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

/** The way of the tool, and the cameras. @param {Sheet} sheet @param {SerialArm} arm @param {Seen} seen */
function wires({ context, toPage, colours, ratio }, arm, { way, cameras }) {
  context.strokeStyle = colours.ink;
  context.lineWidth = 1.6 * ratio;
  context.beginPath();
  way.forEach((configuration) => {
    const [x, y] = toPage(jointsOf(arm, configuration).at(-1) ?? TARGET);
    context.lineTo(x, y);
  });
  context.stroke();
  context.strokeStyle = colours.accent;
  context.lineWidth = 1.2 * ratio;
  for (const { pose } of cameras) {
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

/** @param {number[]} normal */
const shadeOf = (normal) => 0.68 - 0.32 * dot(normal, LIGHT);

/** @param {SerialArm} arm @param {number[]} configuration @returns {[Vector, number][]} */
function spheres(arm, configuration) {
  const links = frames(arm, configuration);
  return arm.parts.flatMap((part) =>
    part.spheres_m.map((sphere) => /** @type {[Vector, number]} */ ([moved(links[part.link], sphere), sphere[3]])),
  );
}

/** @param {Sheet} sheet @param {Vector} centre @param {number} radius m. @param {string} kind @returns {Item} */
function ball({ context, toPage, focal, colours, ratio }, centre, radius, kind) {
  const [x, y, depth] = toPage(centre);
  return {
    depth,
    paint: () => {
      context.beginPath();
      context.arc(x, y, Math.max(1, (radius * focal) / Math.max(0.05, depth)), 0, 2 * Math.PI);
      context.fillStyle = colours[kind];
      context.fill();
      context.strokeStyle = "rgb(0 0 0 / 14%)";
      context.lineWidth = 0.6 * ratio;
      context.stroke();
    },
  };
}

/**
 * An arm that a sample stands for: its joints, and the tool by how sure the model is.
 * @param {Sheet} sheet
 * @param {SerialArm} arm
 * @param {Seen["samples"][number]} sample
 * @returns {Item}
 */
function ghost({ context, toPage, colours, ratio }, arm, { configuration, confidence, free }) {
  const links = jointsOf(arm, configuration).map(toPage);
  const [x, y, depth] = links[links.length - 1];
  return {
    depth,
    paint: () => {
      context.strokeStyle = context.fillStyle = free === false ? colours.wrong : colours.accent;
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

/** Where the links meet, the base first, the tool last. @param {SerialArm} arm @param {number[]} configuration @returns {Vector[]} */
const jointsOf = (arm, configuration) => frames(arm, configuration).map(([x, y, z]) => [x[3], y[3], z[3]]);

/** The page's colours, as they are now. @param {Element} element */
function palette(element) {
  const style = getComputedStyle(element);
  const named = (/** @type {string} */ name) => style.getPropertyValue(`--${name}`).trim();
  const [ink, accent, body, sheet, wrong, soft] = ["ink", "accent", "body", "sheet", "wrong", "soft"].map(named);
  return { ink, accent, body, sheet, wrong, start: soft, goal: `color-mix(in srgb, ${accent} 35%, ${sheet})`, moving: accent };
}
