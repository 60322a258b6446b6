// Sliders of an arm's joints, for its start or its goal.

/** @import {SerialArm} from "./solid.js" */

import { degrees } from "./geometry.js";
import { byId } from "./svg.js";

export class JointSliders {
  /** @param {(end: "start" | "goal", configuration: number[]) => void} moved */
  constructor(moved) {
    this.moved = moved;
    this.select = byId("space-end", HTMLSelectElement);
    /** @type {{slider: HTMLInputElement, told: HTMLOutputElement}[]} */
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
    byId("space-joints", HTMLElement).replaceChildren(
      ...arm.joints.map((joint, at) => {
        const row = document.createElement("label");
        row.className = "joint";
        const slider = document.createElement("input");
        const [low, high] = joint.limits_rad ?? [-Math.PI, Math.PI];
        Object.assign(slider, { type: "range", min: String(low), max: String(high), step: "0.01" });
        const told = document.createElement("output");
        slider.addEventListener("input", () => {
          const configuration = [...this.ends[this.end]];
          configuration[at] = Math.min(high, Math.max(low, Number(slider.value)));
          this.moved(this.end, configuration);
        });
        row.append(`joint ${at + 1}`, slider, told);
        this.rows.push({ slider, told });
        return row;
      }),
    );
  }

  /** @param {Record<"start" | "goal", number[]>} ends */
  show(ends) {
    this.ends = ends;
    this.rows.forEach(({ slider, told }, joint) => {
      const angle = ends[this.end][joint];
      if (document.activeElement !== slider) slider.value = String(angle);
      slider.setAttribute("aria-valuetext", degrees(angle));
      told.textContent = degrees(angle);
    });
  }
}
