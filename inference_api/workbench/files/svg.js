// Elements of the page and of its drawings.

/** Width and height of both drawings, in their own units. */
export const SIDE = 480;
/** What an arrow key turns a joint by. */
export const STEP_RAD = Math.PI / 36;
export const ENDS = /** @type {const} */ (["start", "goal"]);
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/**
 * A new element of a drawing.
 * @template {keyof SVGElementTagNameMap} Name
 * @param {Name} name
 * @param {Record<string, string | number>} [attributes]
 * @returns {SVGElementTagNameMap[Name]}
 */
export function draw(name, attributes = {}) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  set(element, attributes);
  return element;
}

/** @param {Element} element @param {Record<string, string | number>} attributes */
export function set(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
}

/** A new element with text. @param {string} name @param {string} [text] @param {string} [kind]  Its class. */
export const entry = (name, text = "", kind = "") => Object.assign(document.createElement(name), { textContent: text, className: kind });

/**
 * An element of the page by its id.
 * @template {Element} [Kind=HTMLElement]
 * @param {string} id
 * @param {new () => Kind} [kind]
 * @returns {Kind}
 */
export function byId(id, kind = /** @type {any} */ (HTMLElement)) {
  const found = document.getElementById(id);
  if (!(found instanceof kind)) throw new Error(`the page has no ${id}`);
  return found;
}

/** @param {string} id */
export const inputOf = (id) => byId(id, HTMLInputElement);
/** @param {string} id */
export const selectOf = (id) => byId(id, HTMLSelectElement);
/** @param {string} id */
export const buttonOf = (id) => byId(id, HTMLButtonElement);

/** Where a pointer is, in a drawing's units. @param {SVGSVGElement} drawing @param {MouseEvent} event */
export function placeIn(drawing, event) {
  const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(drawing.getScreenCTM()?.inverse());
  return { x, y };
}

/**
 * Let an element be dragged.
 * @param {SVGElement} element
 * @param {SVGSVGElement} drawing
 * @param {(place: {x: number, y: number}, first: boolean) => void} moved  In the drawing's units.
 */
export function draggable(element, drawing, moved) {
  let held = false;
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    held = true;
    element.setPointerCapture(event.pointerId);
    moved(placeIn(drawing, event), true);
  });
  element.addEventListener("pointermove", (event) => {
    if (held) moved(placeIn(drawing, event), false);
  });
  for (const end of ["pointerup", "pointercancel"]) element.addEventListener(end, () => (held = false));
}

/** The direction of an arrow key, y up, finer with Shift; null for other keys. @param {KeyboardEvent} event */
export function arrow(event) {
  const found = ARROWS[/** @type {keyof ARROWS} */ (event.key)];
  if (!found || event.ctrlKey || event.metaKey || event.altKey) return null;
  event.preventDefault();
  return found.map((step) => step * (event.shiftKey ? 0.2 : 1));
}
