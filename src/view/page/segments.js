// The tree of segments.
import { $, focused, say, value } from "./dom.js";
import { question } from "./dialog.js";
import { requestView, stale } from "./picture.js";
import { renamed, row } from "./segment-row.js";
import { change, hear } from "./socket.js";
import { app, emit, on, setAlone, setChecked, setDocument } from "./state.js";

/** @type {string | null} */
let last = null; // the name that was checked or unchecked last
/** @type {string[]} */
let names = []; // the names in the tree, from top to bottom

hear("document", (doc) => {
  for (const [from, to] of setDocument(doc)) {
    if (last === from) last = to;
    renamed(from, to);
  }
  stale();
  tree();
  const [undo, redo] = doc.segment_steps;
  $("segments-undo").disabled = !undo;
  $("segments-redo").disabled = !redo;
  $("segments-undo").title = undo ? `Undo: ${undo}` : "Nothing to undo";
  $("segments-redo").title = redo ? `Redo: ${redo}` : "Nothing to redo";
  emit("document", doc);
  requestView(false);
});

/**
 * Checks or unchecks a segment; with `range`, all from the last one to this one get the same state.
 * @param {string} name
 * @param {boolean} checked
 * @param {boolean} range
 */
function check(name, checked, range) {
  const [from, to] = [last === null ? -1 : names.indexOf(last), names.indexOf(name)].sort((a, b) => a - b);
  const all = range && from >= 0 ? names.slice(from, to + 1) : [name];
  setChecked(all, checked);
  last = name;
  if (all.length > 1) tree();
  emit("checked", undefined);
}

function tree() {
  const wanted = $("search").value.toLowerCase();
  const shown = app.doc.segments.filter((s) => s.name.toLowerCase().includes(wanted));
  names = shown.map((s) => s.name);
  const key = focused()?.dataset.key;
  $("no-segments").hidden = app.doc.segments.length > 0;
  $("search").hidden = app.doc.segments.length < 8;
  $("tree").replaceChildren(...shown.map((s, number) => row(s, number, check)));
  // keyboard focus stays where it was
  if (key) /** @type {HTMLElement | null} */ ($("tree").querySelector(`[data-key="${CSS.escape(key)}"]`))?.focus();
  $("isolate").setAttribute("aria-pressed", String(app.alone.length > 0));
}
$("search").oninput = tree;

/** The checked segments; shows a message if there are none. */
export const chosen = () => {
  if (!app.checked.size) say("Check one or more segments first.", true);
  return [...app.checked];
};

$("coarse").onclick = async () => {
  const text = "Segments found by colour replace all existing segments; undo brings those back.";
  const goes = !app.doc.segments.length || (await question(text, { button: "find by colour" })) !== null;
  if (goes) change({ kind: "coarse", time: value("when"), clusters: null });
};
$("group").onclick = async () => {
  const segments = chosen();
  if (!segments.length) return;
  const name = await question(`Group ${segments.join(", ")} as one segment.`, { button: "group", name: true });
  if (name) change({ kind: "group", name, segments });
};
$("remove").onclick = () => { const segments = chosen(); if (segments.length) change({ kind: "remove", segments }); };
$("isolate").onclick = () => {
  setAlone(app.alone.length ? [] : chosen());
  $("isolate").setAttribute("aria-pressed", String(app.alone.length > 0));
  requestView(false);
};
$("segments-undo").onclick = () => change({ kind: "segments", undo: true });
$("segments-redo").onclick = () => change({ kind: "segments", undo: false });

// hidden and isolated segments may have changed elsewhere
on("restored", tree);
