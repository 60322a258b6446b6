// What the answers say, in figures.

/** @import {Workbench} from "./main.js" */

import { byId, entry } from "./svg.js";

/** Shown where the pointer rests. @type {Record<string, string>} */
const MEANINGS = {
  precision: "share of the samples that are collision-free by the true discs",
  coverage: "share of the free space that has a sample nearby",
  accepted: "share of the proposals whose confidence reaches the minimum",
  novelty: "share of the training pictures that are more usual than this one; from 0.95 on, trust the answer less",
  shortfall: "how many samples of those asked for are missing",
};
const NOVEL = 0.95;

/** @param {Workbench} bench */
export function showFigures({ answer, checks, knowsTruth }) {
  const truth = knowsTruth ? { precision: percent(checks?.precision), coverage: percent(checks?.coverage) } : {};
  const novelty = answer?.scenario.novelty;
  const figures = {
    ...truth,
    samples: `${answer?.samples.length ?? "–"}`,
    accepted: percent(answer?.acceptance),
    novelty: novelty?.toFixed(2) ?? "–",
    shortfall: `${answer?.shortfall ?? "–"}`,
  };
  byId("numbers").replaceChildren(
    ...Object.entries(figures).map(([name, value]) => {
      const pair = entry("div", "", name === "novelty" && novelty >= NOVEL ? "warning" : "");
      pair.append(entry("dt", name), entry("dd", value));
      pair.title = MEANINGS[name] ?? "";
      pair.dataset.name = name;
      return pair;
    }),
  );
  byId("torus-note").textContent = !answer || answer.confidence ? "joint 1 across, joint 2 up" : "this model has no confidence";
}

/** @param {number | null | undefined} share */
const percent = (share) => (typeof share === "number" ? `${(100 * share).toFixed(share === 1 ? 0 : 1)} %` : "–");
