// State that the parts of the page share, and events between them.

export const $ = (id) => document.getElementById(id);
export const canvas = $("picture");

export const app = {
  welcome: null, // the server's description of the run
  camera: null,
  doc: { revision: 0, segments: [], edits: [], segment_steps: [null, null], edit_steps: [false, false] },
  hidden: new Set(), // names of segments hidden in this view
  checked: new Set(), // names of segments that are checked in the tree
  preview: null, // edits that are shown but not saved
  alone: [], // names of isolated segments
  compare: null, // what the picture is compared with
  range: null, // limits of the colour scale, if they are held
  playing: null,
  picked: null, // the last answer to a click
};

// events: "welcome", "document", "picked", "frame", "cleared", "rested", "checked", "restored", "still", "path", "other"
const listeners = {};
export const on = (event, listener) => (listeners[event] ??= []).push(listener);
export const tell = (event, what) => (listeners[event] ?? []).forEach((listener) => listener(what));

export function say(text, wrong = false) {
  $("message").textContent = text;
  $("message").classList.toggle("wrong", wrong);
}

// whether key presses enter text now
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
