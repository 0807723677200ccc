// A segment in the tree: eye, colour, name and opacity, and a second line with rarely used controls.
import { app, element, make } from "./state.js";
import { change, start } from "./socket.js";
import { look } from "./picture.js";
import { timeText } from "./units.js";

const open = new Set(); // names of segments whose second line is open
const hex = (colour) => `#${colour.map((c) => Math.round(255 * Math.min(1, Math.max(0, c))).toString(16).padStart(2, "0")).join("")}`;
const rgb = (text) => [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16) / 255);

// an edit is previewed while a control moves and made once it rests, so that one movement is one step
let waiting = null; // the pending edit: its control, its timer, and the function that makes it
let earlier = []; // pending edits of controls used before: made first, as an edit redraws the row
function pause(key) {
  if (!waiting) return;
  clearTimeout(waiting.timer);
  // a newer value of the same control replaces its pending edit
  if (waiting.key !== key) earlier.push(waiting.make);
  waiting = null;
}
function wait(key, make) {
  pause(key);
  const all = async () => {
    const edits = [...earlier, make];
    [waiting, earlier] = [null, []];
    for (const edit of edits) await edit();
    if (waiting) return;
    app.preview = null;
    look(false);
  };
  waiting = { key, make, timer: setTimeout(all, 400) };
}
function show(s, key, operation) {
  pause(key);
  app.preview = { base: app.doc.revision, edits: operation ? [{ segments: [s.name], operation }] : [] };
  look(true);
}
function makeSoon(s, key, operation) {
  wait(key, async () => operation && change({ kind: "edit", segments: [s.name], operation }));
}

// the edit that leads to an opacity, or null if none is needed: 0 hides, more shows again
function fade(s, wanted) {
  if (wanted === 0) return s.hidden ? null : "hide";
  const factor = wanted / Math.max(s.opacity, 1e-3);
  if (Math.abs(factor - 1) > 1e-3) return { opacity: { factor, show: s.hidden } };
  return s.hidden ? "show" : null;
}

// an input whose value becomes an edit
function edits(kind, key, label, properties, operation, s) {
  const input = make("input", { type: kind, ...properties, disabled: app.welcome?.read_only });
  input.setAttribute("aria-label", label);
  input.dataset.key = key;
  input.title = label;
  input.oninput = () => show(s, key, operation(input.value));
  input.onchange = () => makeSoon(s, key, operation(input.value));
  // moved and put back, it fires no change event
  input.onpointerup = () => earlier.length && !waiting && wait(key, async () => {});
  return input;
}

// an eye icon, open or struck out
function icon(out) {
  const stroke = { fill: "none", stroke: "currentColor", "stroke-width": 1.5, "stroke-linecap": "round" };
  const lids = element("path", { d: "M1.5 8C4 4.2 6 3 8 3s4 1.2 6.5 5C12 11.8 10 13 8 13S4 11.8 1.5 8Z", ...stroke });
  const pupil = element("circle", { cx: 8, cy: 8, r: 2.2, fill: "currentColor" });
  const bar = element("path", { d: "M2.5 13.5 13.5 2.5", ...stroke });
  return element("svg", { viewBox: "0 0 16 16", "aria-hidden": "true" }, lids, out ? bar : pupil);
}

function eye(s) {
  const button = make("button", { className: "eye" });
  button.dataset.key = `eye ${s.name}`;
  button.setAttribute("aria-label", `Hide ${s.name} in this view`);
  const shown = () => {
    const out = app.hidden.has(s.name);
    button.replaceChildren(icon(out));
    button.title = out ? "Hidden in this view: show it (not an edit)" : "Hide it in this view (not an edit)";
    button.setAttribute("aria-pressed", out);
  };
  button.onclick = () => {
    app.hidden.has(s.name) ? app.hidden.delete(s.name) : app.hidden.add(s.name);
    shown();
    look(false);
  };
  shown();
  return button;
}

// the second line: rename, and split by scale
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
  const scale = make("input", { type: "range", min: 0, max: 1, step: 0.05, value: 0.5 });
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
  const found = make("p", { textContent: `${s.gaussians.toLocaleString("en")} Gaussians, found at time ${timeText(s.time)}` });
  const box = make("div", { className: "more" }, found);
  if (!app.welcome?.read_only) box.append(rename, ...(app.welcome?.clicks ? [split] : []));
  return box;
}

// keeps the second line open, and keyboard focus in it
export function renamed(from, to) {
  if (open.delete(from)) open.add(to);
  const at = document.activeElement?.dataset;
  if (at?.key?.endsWith(` ${from}`)) at.key = at.key.slice(0, -from.length) + to;
}

export function row(s, number, check) {
  const item = make("li");
  item.style.paddingLeft = `${s.depth}em`;
  const box = make("input", { type: "checkbox", id: `check-${number}`, checked: app.checked.has(s.name) });
  box.dataset.key = `check ${s.name}`;
  box.setAttribute("aria-label", `Check ${s.name}`);
  box.onclick = (e) => check(s.name, box.checked, e.shiftKey);
  const name = make("label", { className: "name", textContent: s.name, htmlFor: box.id, title: `${s.gaussians.toLocaleString("en")} Gaussians` });
  const colour = edits("color", `colour ${s.name}`, `Colour of ${s.name}`, { value: hex(s.rgb ?? s.colour) },
    (text) => ({ recolour: { rgb: rgb(text), keep_shading: true } }), s);
  const opacity = edits("range", `opacity ${s.name}`, `Opacity of ${s.name}`,
    { min: 0, max: 1, step: 0.05, value: s.hidden ? 0 : Math.min(1, s.opacity) }, (text) => fade(s, Number(text)), s);
  const button = make("button", { textContent: "…", title: "Rename, split" });
  button.dataset.key = `more ${s.name}`;
  button.setAttribute("aria-label", `More options for ${s.name}`);
  const below = more(s);
  const set = (there) => {
    there ? open.add(s.name) : open.delete(s.name);
    below.hidden = !there;
    button.setAttribute("aria-expanded", there);
  };
  button.onclick = () => set(below.hidden);
  set(open.has(s.name));
  name.ondblclick = () => { set(true); below.querySelector("input")?.select(); };
  item.append(box, eye(s), colour, name, opacity, button, below);
  return item;
}
