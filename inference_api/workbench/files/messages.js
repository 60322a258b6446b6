// What the page says: whether the server answers, and what it refused and why.

import { ApiAway, ApiProblem, ask, useKey } from "./api.js";
import { byId, inputOf } from "./svg.js";

const LOOK_MS = 1000;

export class Messages {
  /** @param {() => void} again  Called when the server answers again, or a key was entered. */
  constructor(again) {
    this.again = again;
    this.away = false;
    this.connection = byId("connection");
    this.box = byId("problem");
    this.keyForm = byId("key-form", HTMLFormElement);
    byId("problem-close").addEventListener("click", () => this.clear());
    this.keyForm.addEventListener("submit", (event) => {
      event.preventDefault();
      useKey(inputOf("key").value);
      this.clear();
      this.again();
    });
  }

  /** @param {string} words */
  here(words) {
    if (!this.away) this.connect("here", words);
  }

  /** @param {"here" | "away"} state @param {string} words */
  connect(state, words) {
    this.connection.dataset.state = state;
    this.connection.textContent = words;
  }

  /** @param {unknown} error */
  failed(error) {
    if (error instanceof ApiAway) return void this.wait();
    if (!(error instanceof ApiProblem)) throw error;
    this.show(error.problem);
    this.keyForm.hidden = error.status !== 401;
  }

  /** @param {import("./api.js").Problem} problem */
  show({ title, detail }) {
    byId("problem-title").textContent = title;
    byId("problem-detail").textContent = detail;
    this.box.hidden = false;
  }

  clear() {
    this.box.hidden = true;
    this.keyForm.hidden = true;
  }

  /** Ask until the server answers, then do again what was wanted. */
  async wait() {
    if (this.away) return;
    this.away = true;
    this.connect("away", "The API is not reachable; retrying");
    while (this.away) {
      await new Promise((done) => setTimeout(done, LOOK_MS));
      this.away = await ask("health/live").then(() => false, () => true);
    }
    this.connect("here", "The API is reachable again");
    this.again();
  }
}

/** Say something to screen readers. @param {string} words */
export function speak(words) {
  byId("spoken").textContent = words;
}
