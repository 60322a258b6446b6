// Sliders of an arm's joints, for its start or its goal.

/** @import {End} from "./geometry.js" */
/** @import {SerialArm} from "./solid.js" */

import { degrees } from "./geometry.js";
import { entry } from "./messages.js";
import { byId, selectOf } from "./svg.js";

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
  const told = entry("output");
  slider.addEventListener("input", () => moved(Math.min(high - 1e-6, Math.max(low, Number(slider.value)))));
  row.append(words, slider, told);
  const show = (/** @type {number} */ angle) => {
    slider.value = String(angle);
    told.textContent = degrees(angle);
    slider.setAttribute("aria-valuetext", told.textContent);
  };
  return { row, show };
}

/**
 * A row for each joint of a configuration.
 * @param {string} words
 * @param {number[][]} limits  rad, of each joint.
 * @param {(configuration: number[]) => void} moved
 */
export function jointRows(words, limits, moved) {
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

export class JointSliders {
  /** @param {(end: End, configuration: number[]) => void} moved */
  constructor(moved) {
    this.moved = moved;
    this.select = selectOf("space-end");
    this.shown = jointRows("", [], () => {});
    /** @type {Record<End, number[]>} */
    this.ends = { start: [], goal: [] };
    this.select.addEventListener("change", () => this.show(this.ends));
  }

  /** Whose joints are moved. @returns {End} */
  get end() {
    return this.select.value === "start" ? "start" : "goal";
  }

  /** One row a joint. @param {SerialArm} arm */
  make(arm) {
    const limits = arm.joints.map((joint) => joint.limits_rad ?? [-Math.PI, Math.PI]);
    this.shown = jointRows("joint", limits, (configuration) => this.moved(this.end, configuration));
    byId("space-joints").replaceChildren(...this.shown.rows);
  }

  /** @param {Record<End, number[]>} ends */
  show(ends) {
    this.ends = ends;
    this.shown.show(ends[this.end]);
  }
}
