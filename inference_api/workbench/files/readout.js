// What the answers say, in figures and in a legend.

/** @import {Workbench} from "./main.js" */

import { entry } from "./messages.js";
import { byId, draw } from "./svg.js";

export class Readout {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    /** @type {any} */
    this.answer = null;
    /** @type {any} */
    this.truth = null;
    this.legend = "";
  }

  /** @param {any} answer  Of POST /sample. */
  showAnswer(answer) {
    this.answer = answer;
    this.showNumbers();
    const threshold = answer.confidence ? "" : "this model has no confidence";
    byId("torus-note", HTMLElement).textContent = threshold || "joint 1 across, joint 2 up";
    this.showLegend(Boolean(answer.confidence));
  }

  /** @param {any} truth */
  showTruth(truth) {
    this.truth = truth;
    this.showNumbers();
    const family = byId("family", HTMLSelectElement);
    const names = [...family.options].map((option) => option.value);
    if (names.join() !== truth.families.join()) family.replaceChildren(...truth.families.map((/** @type {string} */ name) => new Option(name, name)));
  }

  showNumbers() {
    const { about, state } = this.bench;
    const { answer } = this;
    const truth = about.truth && !state.picture ? this.truth : null;
    /** @type {[string, string][]} */
    const told = [
      ["samples", `${answer.samples.length}`],
      ["accepted", percent(answer.acceptance)],
      ["novelty", answer.scenario.novelty === null ? "–" : answer.scenario.novelty.toFixed(2)],
    ];
    if (truth) {
      told.unshift(["precision", percent(truth.precision)], ["coverage", percent(truth.coverage)]);
      told.push(["shortfall", `${answer.shortfall}`]);
    } else told.push(["shortfall", `${answer.shortfall}`]);
    byId("numbers", HTMLElement).replaceChildren(
      ...told.map(([name, value]) => {
        const pair = document.createElement("div");
        pair.append(entry("dt", name), entry("dd", value));
        return pair;
      }),
    );
  }

  /** @param {boolean} confident  Whether the model tells its confidence. */
  showLegend(confident) {
    const { state, about } = this.bench;
    const truth = about.truth && !state.picture;
    /** @type {[string, string, string][]} */
    const told = confident
      ? [["dots dots-1", "M7 7h0", "confidence from 0.5"], ["dots dots-2", "M7 7h0", "0.9"], ["dots dots-3", "M7 7h0", "0.99"]]
      : [["dots dots-3", "M7 7h0", "samples"]];
    if (truth) told.push(["crosses", "M3 3l8 8m-8 0l8-8", "collides in truth"]);
    if (state.ground === "belief") told.push(["ground ground-3", "M1 1h12v12h-12z", "believed to collide"]);
    else if (state.ground === "truth" && truth) told.push(["ground", "M1 1h12v12h-12z", "collision region"]);
    const key = JSON.stringify(told);
    if (key === this.legend) return;
    this.legend = key;
    byId("legend", HTMLElement).replaceChildren(
      ...told.map(([kind, path, words]) => {
        const item = entry("li", "");
        const sign = draw("svg", { viewBox: "0 0 14 14", "aria-hidden": "true" });
        sign.append(draw("path", { class: kind, d: path }));
        item.append(sign, words);
        return item;
      }),
    );
  }
}

/** @param {number | null} share */
function percent(share) {
  return share === null ? "–" : `${(100 * share).toFixed(share === 1 ? 0 : 1)} %`;
}
