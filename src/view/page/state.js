// What the parts of the page share, and how they hear of one another.

export const $ = (id) => document.getElementById(id);
export const canvas = $("picture");

export const app = {
  welcome: null, // what the server says of the run
  camera: null,
  doc: { revision: 0, segments: [], edits: [], segment_steps: [null, null], edit_steps: [false, false] },
  hidden: new Set(), // names of segments that are left out of the picture
  checked: new Set(), // names of segments that are checked in the tree
  preview: null, // edits that are shown and not saved
  alone: [], // names of segments that are shown alone
  compare: null, // what the picture is compared with
  range: null, // values at the ends of the colours' scale, if they are held
  playing: null,
  picked: null, // the last answer to a click
};

// news: "welcome", "document", "picked", "frame", "cleared", "rested", "checked", "restored", "still", "path", "other"
const listeners = {};
export const on = (news, listener) => (listeners[news] ??= []).push(listener);
export const tell = (news, what) => (listeners[news] ?? []).forEach((listener) => listener(what));

export function say(text, wrong = false) {
  $("message").textContent = text;
  $("message").classList.toggle("wrong", wrong);
}

// whether keys are text now
export const typing = () => {
  const at = document.activeElement;
  return /INPUT|SELECT|TEXTAREA/.test(at?.tagName) && !/range|checkbox|color/.test(at.type);
};

// seconds in words
export const duration = (seconds) => (seconds < 90 ? `${seconds.toFixed(0)} s` : seconds < 5400 ? `${(seconds / 60).toFixed(1)} min` : `${(seconds / 3600).toFixed(1)} h`);

export const value = (id) => Number($(id).value);

const SVG = "http://www.w3.org/2000/svg";

// an SVG element with attributes and children
export function element(kind, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

// an element with properties and children
export function make(kind, properties = {}, ...children) {
  const element = Object.assign(document.createElement(kind), properties);
  element.append(...children);
  return element;
}
