// Elements of the page: finding them by their ids, making them, and the line of messages.
/** @import { Elements } from "./elements" */

/**
 * @template {keyof Elements} K
 * @param {K} id
 * @returns {Elements[K]}
 */
export const $ = (id) => /** @type {any} */ (document.getElementById(id));

export const canvas = $("picture");

/**
 * The context of a canvas, on which pictures are drawn.
 * @param {HTMLCanvasElement} canvas
 * @param {CanvasRenderingContext2DSettings} [settings]
 */
export const context2d = (canvas, settings) => /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", settings));

/** Shows a message. @param {string} text @param {boolean} [wrong] whether something failed */
export function say(text, wrong = false) {
  $("message").textContent = text;
  $("message").classList.toggle("wrong", wrong);
}

/** The element that has the focus. */
export const focused = () => /** @type {HTMLElement | null} */ (document.activeElement);

/** The type of the input that has the focus, such as "range"; empty if none has. */
export const focusedInput = () => {
  const at = focused();
  return at instanceof HTMLInputElement ? at.type : "";
};

/** Whether key presses enter text now. */
export const typing = () => {
  const at = focused();
  return Boolean(at && /INPUT|SELECT|TEXTAREA/.test(at.tagName) && !/range|checkbox|color/.test(focusedInput()));
};

/** @typedef {{ [K in keyof Elements]: Elements[K] extends { value: string | number } ? K : never }[keyof Elements]} Valued */

/** The number in an input. @param {Valued} id */
export const value = (id) => Number($(id).value);

const SVG = "http://www.w3.org/2000/svg";

/**
 * An SVG element with attributes and children.
 * @template {keyof SVGElementTagNameMap} K
 * @param {K} kind
 * @param {Record<string, string | number>} attributes
 * @param {(Node | string)[]} children
 * @returns {SVGElementTagNameMap[K]}
 */
export function element(kind, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, String(value));
  made.append(...children);
  return made;
}

/**
 * An element with properties and children.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} kind
 * @param {Partial<HTMLElementTagNameMap[K]>} properties
 * @param {(Node | string)[]} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function make(kind, properties = {}, ...children) {
  const made = Object.assign(document.createElement(kind), properties);
  made.append(...children);
  return made;
}
