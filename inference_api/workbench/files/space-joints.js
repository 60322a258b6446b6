// Sliders of an arm's joints, for its start or its goal.

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
export function jointRow(words, low, high, moved) {
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

export class JointSliders {
  /** @param {(end: "start" | "goal", configuration: number[]) => void} moved */
  constructor(moved) {
    this.moved = moved;
    this.select = selectOf("space-end");
    /** @type {((angle: number) => void)[]} */
    this.rows = [];
    /** @type {Record<"start" | "goal", number[]>} */
    this.ends = { start: [], goal: [] };
    this.select.addEventListener("change", () => this.show(this.ends));
  }

  /** Whose joints are moved. @returns {"start" | "goal"} */
  get end() {
    return this.select.value === "start" ? "start" : "goal";
  }

  /** One row a joint. @param {SerialArm} arm */
  make(arm) {
    this.rows = [];
    byId("space-joints").replaceChildren(
      ...arm.joints.map((joint, at) => {
        const [low, high] = joint.limits_rad ?? [-Math.PI, Math.PI];
        const { row, show } = jointRow(`joint ${at + 1}`, low, high, (angle) => {
          const configuration = [...this.ends[this.end]];
          configuration[at] = angle;
          this.moved(this.end, configuration);
        });
        this.rows.push(show);
        return row;
      }),
    );
  }

  /** @param {Record<"start" | "goal", number[]>} ends */
  show(ends) {
    this.ends = ends;
    this.rows.forEach((show, joint) => show(ends[this.end][joint]));
  }
}
