// What the page says: whether the server answers, what it refused and why, what was done.

import { ApiAway, ApiProblem, ask, useKey } from "./api.js";
import { byId } from "./svg.js";

const LOOK_MS = 1000;

export class Messages {
  /** @param {() => void} again  What is done when the server answers again, or a key was entered. */
  constructor(again) {
    this.again = again;
    this.away = false;
    this.connection = byId("connection", HTMLElement);
    this.box = byId("problem", HTMLElement);
    this.keyForm = byId("key-form", HTMLFormElement);
    byId("problem-close", HTMLButtonElement).addEventListener("click", () => this.clear());
    this.keyForm.addEventListener("submit", (event) => {
      event.preventDefault();
      useKey(byId("key", HTMLInputElement).value);
      this.clear();
      this.again();
    });
  }

  /** @param {string} words */
  here(words) {
    if (this.away) return;
    this.tell("here", words);
  }

  /** @param {"here" | "away" | "waiting"} state @param {string} words */
  tell(state, words) {
    this.connection.dataset.state = state;
    if (this.connection.textContent !== words) this.connection.textContent = words;
  }

  /** What an error says to the person at the page. @param {unknown} error */
  failed(error) {
    if (error instanceof ApiAway) {
      this.wait();
      return;
    }
    if (!(error instanceof ApiProblem)) throw error;
    this.show(error.problem);
    this.keyForm.hidden = error.status !== 401;
  }

  /** What the page itself does not take. @param {string} title @param {string} detail @param {string} expected */
  refuse(title, detail, expected) {
    this.show({ title, detail, expected });
  }

  /** @param {import("./api.js").Problem} problem */
  show({ title, detail, expected, got, remedy }) {
    byId("problem-title", HTMLElement).textContent = title;
    byId("problem-detail", HTMLElement).textContent = detail;
    const more = Object.entries({ expected, got, remedy }).filter(([, text]) => text);
    byId("problem-more", HTMLElement).replaceChildren(
      ...more.flatMap(([name, text]) => [entry("dt", name), entry("dd", String(text))]),
    );
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
    this.tell("away", "The API is away; trying again");
    while (this.away) {
      await new Promise((done) => setTimeout(done, LOOK_MS));
      this.away = await ask("health/live").then(() => false, () => true);
    }
    this.tell("here", "The API is back");
    this.again();
  }
}

/**
 * @param {"dt" | "dd" | "li" | "p" | "td" | "th"} name
 * @param {string} text
 */
export function entry(name, text) {
  const element = document.createElement(name);
  element.textContent = text;
  return element;
}

/** Say something to screen readers. @param {string} words */
export function speak(words) {
  byId("spoken", HTMLElement).textContent = words;
}
