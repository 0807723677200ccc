// A segment in the tree: eye, colour, name and opacity, and a second line with rarely used controls.
import { element, focused, make } from "./dom.js";
import { fade, hex, recolour } from "./operations.js";
import { requestView } from "./picture.js";
import { change, start } from "./socket.js";
import { app, setPreview, toggleHidden } from "./state.js";
import { count, timeText } from "./units.js";
/** @import { Operation, SegmentRow } from "./protocol" */

/** @type {Set<string>} */
const open = new Set(); // names of segments whose second line is open

// an edit is previewed while a control moves and made once it rests, so that one movement is one step
/** @type {{ key: string, save: () => unknown, timer: number } | null} */
let waiting = null; // the pending edit: its control, the function that makes it, and its timer
/** @type {(() => unknown)[]} */
let earlier = []; // pending edits of controls used before: made first, as an edit redraws the row
/** @param {string} key */
function pause(key) {
  if (!waiting) return;
  clearTimeout(waiting.timer);
  // a newer value of the same control replaces its pending edit
  if (waiting.key !== key) earlier.push(waiting.save);
  waiting = null;
}
/** @param {string} key @param {() => unknown} save */
function wait(key, save) {
  pause(key);
  const all = async () => {
    const edits = [...earlier, save];
    [waiting, earlier] = [null, []];
    for (const edit of edits) await edit();
    if (waiting) return;
    setPreview(null);
    requestView(false);
  };
  waiting = { key, save, timer: setTimeout(all, 400) };
}

/**
 * An input whose value becomes an edit of the segment.
 * @param {SegmentRow} s
 * @param {string} what it sets
 * @param {Partial<HTMLInputElement>} properties
 * @param {(text: string) => Operation | null} operation
 */
function editor(s, what, properties, operation) {
  const key = `${what} ${s.name}`, label = `${what[0].toUpperCase()}${what.slice(1)} of ${s.name}`;
  const input = make("input", { ...properties, disabled: app.welcome?.read_only });
  const edits = () => {
    const made = operation(input.value);
    return made ? [{ segments: [s.name], operation: made }] : [];
  };
  input.setAttribute("aria-label", label);
  input.dataset.key = key;
  input.title = label;
  input.oninput = () => {
    pause(key);
    setPreview(edits());
    requestView(true);
  };
  input.onchange = () => {
    const [edit] = edits();
    wait(key, async () => edit && change({ kind: "edit", ...edit }));
  };
  // moved and put back, it fires no change event
  input.onpointerup = () => earlier.length && !waiting && wait(key, async () => {});
  return input;
}

/** An eye icon, open or struck out. @param {boolean} out */
function icon(out) {
  const stroke = { fill: "none", stroke: "currentColor", "stroke-width": 1.5, "stroke-linecap": "round" };
  const lids = element("path", { d: "M1.5 8C4 4.2 6 3 8 3s4 1.2 6.5 5C12 11.8 10 13 8 13S4 11.8 1.5 8Z", ...stroke });
  const pupil = element("circle", { cx: 8, cy: 8, r: 2.2, fill: "currentColor" });
  const bar = element("path", { d: "M2.5 13.5 13.5 2.5", ...stroke });
  return element("svg", { viewBox: "0 0 16 16", "aria-hidden": "true" }, lids, out ? bar : pupil);
}

/** @param {SegmentRow} s */
function eye(s) {
  const button = make("button", { className: "eye" });
  button.dataset.key = `eye ${s.name}`;
  button.setAttribute("aria-label", `Hide ${s.name} in this view`);
  const update = () => {
    const out = app.hidden.has(s.name);
    button.replaceChildren(icon(out));
    button.title = out ? "Hidden in this view: show it (not an edit)" : "Hide it in this view (not an edit)";
    button.setAttribute("aria-pressed", String(out));
  };
  button.onclick = () => {
    toggleHidden(s.name);
    update();
    requestView(false);
  };
  update();
  return button;
}

/** The second line: rename, and split by scale. @param {SegmentRow} s */
function more(s) {
  const rename = make("form", { className: "row" });
  const name = make("input", { value: s.name, maxLength: 100, pattern: "[A-Za-z0-9_][A-Za-z0-9_.\\-]*", autocomplete: "off" });
  name.dataset.key = `name ${s.name}`;
  name.setAttribute("aria-label", `Name of ${s.name}`);
  rename.append(name, make("button", { textContent: "rename" }));
  rename.onsubmit = (e) => {
    e.preventDefault();
    const wanted = name.value.trim();
    if (wanted && wanted !== s.name) change({ kind: "rename", segment: s.name, name: wanted });
  };
  const split = make("form", { className: "row" });
  const scale = make("input", { type: "range", min: "0", max: "1", step: "0.05", value: "0.5" });
  const label = make("label", { textContent: "scale " });
  const shownScale = make("output", { textContent: "0.50" });
  scale.dataset.key = `scale ${s.name}`;
  scale.setAttribute("aria-label", `Scale of the parts of ${s.name}`);
  scale.oninput = () => { shownScale.textContent = Number(scale.value).toFixed(2); };
  label.append(scale, shownScale);
  split.append(label, make("button", { textContent: "split", title: "Split by features into parts, from small (0) to large (1)" }));
  split.onsubmit = (e) => {
    e.preventDefault();
    start({ kind: "split", segment: s.name, scale: Number(scale.value), clusters: null, replace: false });
  };
  const found = make("p", { textContent: `${count(s.gaussians)} Gaussians, found at time ${timeText(s.time)}` });
  const box = make("div", { className: "more" }, found);
  if (!app.welcome?.read_only) box.append(rename, ...(app.welcome?.clicks ? [split] : []));
  return box;
}

/** Keeps the second line open, and keyboard focus in it. @param {string} from @param {string} to */
export function renamed(from, to) {
  if (open.delete(from)) open.add(to);
  const at = focused()?.dataset;
  if (at?.key?.endsWith(` ${from}`)) at.key = at.key.slice(0, -from.length) + to;
}

/**
 * @param {SegmentRow} s
 * @param {number} number of the row
 * @param {(name: string, checked: boolean, range: boolean) => void} check called when it is checked or unchecked
 */
export function row(s, number, check) {
  const item = make("li");
  item.style.paddingLeft = `${s.depth}em`;
  const box = make("input", { type: "checkbox", id: `check-${number}`, checked: app.checked.has(s.name) });
  box.dataset.key = `check ${s.name}`;
  box.setAttribute("aria-label", `Check ${s.name}`);
  box.onclick = (e) => check(s.name, box.checked, e.shiftKey);
  const name = make("label", { className: "name", textContent: s.name, htmlFor: box.id, title: `${count(s.gaussians)} Gaussians` });
  const colour = editor(s, "colour", { type: "color", value: hex(s.rgb ?? s.colour) }, recolour);
  const shown = s.hidden ? 0 : Math.min(1, s.opacity);
  const slider = { type: "range", min: "0", max: "1", step: "0.05", value: String(shown) };
  const opacity = editor(s, "opacity", slider, (text) => fade(s, Number(text)));
  const button = make("button", { textContent: "…", title: "Rename, split" });
  button.dataset.key = `more ${s.name}`;
  button.setAttribute("aria-label", `More options for ${s.name}`);
  const below = more(s);
  /** @param {boolean} there */
  const set = (there) => {
    there ? open.add(s.name) : open.delete(s.name);
    below.hidden = !there;
    button.setAttribute("aria-expanded", String(there));
  };
  button.onclick = () => set(Boolean(below.hidden));
  set(open.has(s.name));
  name.ondblclick = () => { set(true); below.querySelector("input")?.select(); };
  item.append(box, eye(s), colour, name, opacity, button, below);
  return item;
}
