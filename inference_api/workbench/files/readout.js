// What the answers say, in figures and in a legend.

/** @import {Workbench} from "./main.js" */
/** @import {Side} from "./side.js" */

import { entry, offerNames, showFigures } from "./messages.js";
import { searchedMs } from "./planner.js";
import { byId, draw } from "./svg.js";

/** What the figures mean, shown where the pointer rests. @type {Record<string, string>} */
const MEANINGS = {
  precision: "share of the samples that are collision-free by the true discs",
  coverage: "share of the free space that has a sample nearby",
  accepted: "share of the proposals whose confidence reaches the minimum",
  novelty: "share of the training pictures that are more usual than this one; from 0.95 on, trust the answer less",
  shortfall: "how many samples of those asked for are missing",
};
const NOVEL = 0.95;

export class Readout {
  /** @param {Workbench} bench */
  constructor(bench) {
    this.bench = bench;
    this.legend = "";
  }

  /** Show what has been answered. */
  show() {
    const { first, beside } = this.bench;
    if (!first.answer) return;
    const two = this.bench.sides().length > 1;
    byId("numbers").hidden = two;
    byId("compared", HTMLTableElement).hidden = !two;
    const axes = first.answer.confidence ? "joint 1 across, joint 2 up" : "this model has no confidence";
    byId("torus-note").textContent = two ? first.title : axes;
    byId("beside-note").textContent = beside.title;
    if (two) this.compare();
    else this.showNumbers();
    this.showLegend(Boolean(first.answer.confidence));
    if (first.truth) offerNames("family", first.truth.families);
  }

  /** What a model's samples are like. @param {Side} side @returns {[string, string][]} */
  figures({ answer, truth }) {
    /** @type {[string, string][]} */
    const figures = [];
    if (this.bench.about.truth && !this.bench.state.picture) {
      figures.push(["precision", percent(truth?.precision)], ["coverage", percent(truth?.coverage)]);
    }
    figures.push(
      ["samples", `${answer?.samples.length ?? "–"}`],
      ["accepted", percent(answer?.acceptance)],
      ["novelty", answer?.scenario.novelty?.toFixed(2) ?? "–"],
      ["shortfall", `${answer?.shortfall ?? "–"}`],
    );
    return figures;
  }

  showNumbers() {
    showFigures("numbers", this.figures(this.bench.first), MEANINGS);
    const novelty = this.bench.first.answer?.scenario.novelty ?? 0;
    document.querySelector("#numbers [data-name=novelty]")?.classList.toggle("warning", novelty >= NOVEL);
  }

  /** Two models in a table: a column each, for that fits a phone. */
  compare() {
    const sides = this.bench.sides();
    const rows = sides.map((side) => [
      ...this.figures(side),
      ["sampled in", side.answer ? `${side.answer.timing_ms.total.toFixed(1)} ms` : "–"],
      ...(sides.some(({ planned }) => planned) ? planFigures(side.planned, this.bench.grows) : []),
    ]);
    const table = byId("compared", HTMLTableElement);
    table.replaceChildren();
    const head = table.createTHead().insertRow();
    head.insertCell();
    head.append(...sides.map((side) => header(side.title, "col")));
    const body = table.createTBody();
    rows[0].forEach(([name], at) => {
      const head = header(name, "row");
      head.title = MEANINGS[name] ?? "";
      body.insertRow().append(head, ...rows.map((row) => entry("td", row[at][1])));
    });
  }

  /** @param {boolean} confident  Whether the model has confidence. */
  showLegend(confident) {
    const { state, about } = this.bench;
    const truth = about.truth && !state.picture;
    /** @type {[string, string, string][]} */
    const items = confident
      ? [["dots dots-1", "M7 7h0", "confidence from 0.5"], ["dots dots-2", "M7 7h0", "0.9"], ["dots dots-3", "M7 7h0", "0.99"]]
      : [["dots dots-3", "M7 7h0", "samples"]];
    if (truth) items.push(["crosses", "M3 3l8 8m-8 0l8-8", "collides (ground truth)"]);
    if (state.ground === "prediction") items.push(["ground ground-3", "M1 1h12v12h-12z", "predicted to collide"]);
    else if (state.ground === "truth" && truth) items.push(["ground", "M1 1h12v12h-12z", "collision region"]);
    const key = JSON.stringify(items);
    if (key === this.legend) return;
    this.legend = key;
    byId("legend").replaceChildren(
      ...items.map(([kind, path, words]) => {
        const item = entry("li", "");
        const sign = draw("svg", { viewBox: "0 0 14 14", "aria-hidden": "true" });
        sign.append(draw("path", { class: kind, d: path }));
        item.append(sign, words);
        return item;
      }),
    );
  }
}

/**
 * What a model’s path is like.
 * @param {import("./planner.js").Planned | null} planned
 * @param {boolean} grown  By trees.
 * @returns {[string, string][]}
 */
function planFigures(planned, grown) {
  const { answer, verdict } = planned ?? { answer: null, verdict: null };
  const found = answer?.path.length > 1;
  /** @type {[string, string][]} */
  const own = grown
    ? [["iterations", `${answer?.iterations ?? "–"}`], ["edges checked", `${answer?.edge_checks ?? "–"}`], ["states checked", `${answer?.state_checks ?? "–"}`]]
    : [["confidence", answer?.confidence?.toFixed(3) ?? "–"], ["lowest confidence", answer?.least_sure?.confidence.toFixed(3) ?? "–"], ["paths found", `${answer?.ways ?? "–"}`]];
  return [
    ["plan", answer?.status ?? "–"],
    ...own,
    ["length", found ? `${answer.length_rad.toFixed(2)} rad` : "–"],
    ["planned in", answer ? `${searchedMs(answer)} ms` : "–"],
    ["collision-free (ground truth)", verdict ? (verdict.free ? "yes" : "no") : "–"],
  ];
}

/** @param {string} text @param {string} scope */
function header(text, scope) {
  const made = entry("th", text);
  made.setAttribute("scope", scope);
  return made;
}

/** @param {number | null | undefined} share */
function percent(share) {
  return share === null || share === undefined ? "–" : `${(100 * share).toFixed(share === 1 ? 0 : 1)} %`;
}
