// State that the modules of the page share, and events between them. Modules read it as `app` and change it only by the
// functions here. Nothing here needs a browser.
import { Listeners } from "./listeners.js";
/** @import { Edit, Selected } from "./protocol" */
/** @import { AppState, Camera, Events, SegmentDocument, Welcome } from "./types" */

/** @type {AppState} */
const state = {
  welcome: null,
  camera: null,
  doc: { revision: 0, renamed: [], segments: [], edits: [], segment_steps: [null, null], edit_steps: [false, false] },
  hidden: new Set(),
  checked: new Set(),
  preview: null,
  alone: [],
  compare: null,
  range: null,
  playing: null,
  picked: null,
};

/** @type {Readonly<AppState>} */
export const app = state;

/** @param {Welcome} welcome */
export const setWelcome = (welcome) => { state.welcome = welcome; };

/** @param {Camera} camera */
export const setCamera = (camera) => { state.camera = camera; };

/**
 * A renamed segment, whoever renamed it, stays checked, hidden or isolated; a removed one does not.
 * @param {SegmentDocument} doc
 * @returns {Map<string, string>} new names by old ones
 */
export function setDocument(doc) {
  const names = new Set(doc.segments.map((s) => s.name));
  const renamed = new Map(doc.renamed.filter(([from, to]) => !names.has(from) && names.has(to)));
  /** @param {Iterable<string>} list */
  const kept = (list) => [...list].map((name) => renamed.get(name) ?? name).filter((name) => names.has(name));
  state.doc = doc;
  // it belonged to another document
  state.preview = null;
  state.hidden = new Set(kept(state.hidden));
  state.checked = new Set(kept(state.checked));
  state.alone = kept(state.alone);
  return renamed;
}

/** Shows edits of the present document without saving them. @param {Edit[] | null} edits */
export const setPreview = (edits) => { state.preview = edits && { base: state.doc.revision, edits }; };

/** @param {Iterable<string>} names */
export const setHidden = (names) => { state.hidden = new Set(names); };

/** @param {string} name */
export const toggleHidden = (name) =>
  setHidden(state.hidden.has(name) ? [...state.hidden].filter((other) => other !== name) : [...state.hidden, name]);

/** @param {Iterable<string>} names @param {boolean} checked */
export function setChecked(names, checked) {
  const all = new Set(state.checked);
  for (const name of names) checked ? all.add(name) : all.delete(name);
  state.checked = all;
}

/** @param {readonly string[]} names */
export const setAlone = (names) => { state.alone = names; };

/** @param {AppState["compare"]} compare */
export const setComparison = (compare) => { state.compare = compare; };

/** @param {AppState["range"]} range */
export const setRange = (range) => { state.range = range; };

/** @param {AppState["playing"]} playing */
export const setPlaying = (playing) => { state.playing = playing; };

/** @param {Selected | null} picked */
export const setPicked = (picked) => { state.picked = picked; };

/** @type {Listeners<Events>} */
const listeners = new Listeners();

/**
 * Calls the listener for every event of this name; returns a function that ends this.
 * @template {keyof Events} E
 * @param {E} event
 * @param {(what: Events[E]) => void} listener
 */
export const on = (event, listener) => listeners.on(event, listener);

/**
 * @template {keyof Events} E
 * @param {E} event
 * @param {Events[E]} what
 */
export const emit = (event, what) => listeners.emit(event, what);
