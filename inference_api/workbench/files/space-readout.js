// What is told of a scene in space: figures, and what its cameras see.

import { entry, showFigures } from "./messages.js";
import { fromBase64 } from "./picture.js";
import { byId } from "./svg.js";

/** The cameras' pictures, as pictures of the page. */
export class Previews {
  constructor() {
    /** @type {string[]} */
    this.addresses = [];
  }

  /** @param {string[]} previews  Base64 of PNGs. */
  show(previews) {
    this.addresses.forEach((address) => URL.revokeObjectURL(address));
    this.addresses = previews.map((one) => URL.createObjectURL(new Blob([fromBase64(one)], { type: "image/png" })));
    byId("space-pictures").replaceChildren(
      ...this.addresses.map((address, at) => {
        const picture = entry("img");
        Object.assign(picture, { src: address, alt: `Depth picture of camera ${at + 1}`, width: 128, height: 128 });
        return picture;
      }),
    );
  }
}

/**
 * @param {{confidence: number[] | null, unseen: number[] | null}} answer  Of POST /sample.
 * @param {boolean[] | null} free  In truth, of its samples.
 */
export function showSpaceNumbers(answer, free) {
  const told = {
    "believed free": mean(answer.confidence),
    "free in truth": mean(free ? free.map(Number) : null),
    "of the arm unseen": mean(answer.unseen),
  };
  showFigures("space-numbers", Object.entries(told));
}

/** @param {number[] | null} values */
function mean(values) {
  if (!values?.length) return "–";
  return `${((100 * values.reduce((sum, one) => sum + one, 0)) / values.length).toFixed(0)} %`;
}
