// What the page says: whether the server answers, what it refused and why, what was done.

import { ApiAway, ApiProblem, ask, useKey } from "./api.js";
import { byId, inputOf, selectOf } from "./svg.js";

const LOOK_MS = 1000;

export class Messages {
  /** @param {() => void} again  What is done when the server answers again, or a key was entered. */
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
    if (this.away) return;
    this.showConnection("here", words);
  }

  /** @param {"here" | "away" | "waiting"} state @param {string} words */
  showConnection(state, words) {
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
    byId("problem-title").textContent = title;
    byId("problem-detail").textContent = detail;
    const more = Object.entries({ expected, got, remedy }).filter(([, text]) => text);
    byId("problem-more").replaceChildren(
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
    this.showConnection("away", "The API is not reachable; retrying");
    while (this.away) {
      await new Promise((done) => setTimeout(done, LOOK_MS));
      this.away = await ask("health/live").then(() => false, () => true);
    }
    this.showConnection("here", "The API is reachable again");
    this.again();
  }
}

/**
 * @template {keyof HTMLElementTagNameMap} Name
 * @param {Name} name
 * @param {string} [text]
 * @param {string} [kind]  Its class.
 */
export function entry(name, text = "", kind = "") {
  const element = document.createElement(name);
  element.textContent = text;
  if (kind) element.className = kind;
  return element;
}

/**
 * @param {string} id  Of a list.
 * @param {[string, string][]} figures
 * @param {Record<string, string>} meanings  By name.
 */
export function showFigures(id, figures, meanings) {
  byId(id).replaceChildren(
    ...figures.map(([name, value]) => {
      const pair = entry("div");
      pair.append(entry("dt", name), entry("dd", value));
      pair.title = meanings[name] ?? "";
      pair.dataset.name = name;
      return pair;
    }),
  );
}

/** Fill a list of names again where it has others. @param {string} id @param {string[]} names */
export function offerNames(id, names) {
  const select = selectOf(id);
  if ([...select.options].map((option) => option.value).join() === names.join()) return;
  select.replaceChildren(...names.map((name) => new Option(name, name)));
}

/** Say something to screen readers. @param {string} words */
export function speak(words) {
  byId("spoken").textContent = words;
}
