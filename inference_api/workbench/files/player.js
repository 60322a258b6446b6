// Plays a path: a button, a slider, and the share of the path so far.

import { buttonOf, inputOf } from "./svg.js";

export class Player {
  /**
   * @param {string} button  Id of the button that plays and pauses.
   * @param {string} slider  Id of the slider along the path.
   * @param {number} lastsMs  How long a path takes.
   * @param {() => void} draw
   */
  constructor(button, slider, lastsMs, draw) {
    this.button = buttonOf(button);
    this.slider = inputOf(slider);
    this.lastsMs = lastsMs;
    this.draw = draw;
    this.share = 0;
    this.playing = false;
    this.loaded = false;
    this.button.addEventListener("click", () => (this.playing ? this.stop() : this.play()));
    this.slider.addEventListener("input", () => {
      this.share = Number(this.slider.value) / 1000;
      this.stop();
    });
  }

  /** There is a path, or there is none any more. @param {boolean} there */
  load(there) {
    this.loaded = there;
    this.share = 0;
    this.stop();
  }

  /** Play by itself, unless somebody wants less motion. */
  begin() {
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) this.play();
  }

  play() {
    if (!this.loaded) return;
    this.playing = true;
    if (this.share >= 1) this.share = 0;
    let last = performance.now();
    const tick = (/** @type {number} */ now) => {
      if (!this.playing) return;
      this.share = Math.min(1, this.share + Math.max(0, now - last) / this.lastsMs);
      last = now;
      if (this.share >= 1) this.stop();
      else {
        this.show();
        requestAnimationFrame(tick);
      }
    };
    requestAnimationFrame(tick);
    this.show();
  }

  stop() {
    this.playing = false;
    this.show();
  }

  show() {
    this.button.disabled = !this.loaded;
    this.slider.disabled = !this.loaded;
    this.slider.value = String(Math.round(1000 * this.share));
    this.button.textContent = this.playing ? "Pause" : "Play";
    this.draw();
  }
}
