// The tree of segments.
import { $, app, on, say, tell, value } from "./state.js";
import { change, hear } from "./socket.js";
import { look, stale } from "./picture.js";
import { renamed, row } from "./row.js";
import { question } from "./dialog.js";

// a renamed segment, whoever renamed it, stays checked, hidden or isolated
function keep(from, to) {
  for (const set of [app.hidden, app.checked]) if (set.delete(from)) set.add(to);
  app.alone = app.alone.map((name) => (name === from ? to : name));
  if (last === from) last = to;
  renamed(from, to);
}

function read(message) {
  app.doc = message;
  // it belonged to another document
  app.preview = null;
  stale();
  const names = new Set(app.doc.segments.map((s) => s.name));
  for (const [from, to] of message.renamed) if (!names.has(from) && names.has(to)) keep(from, to);
  for (const set of [app.hidden, app.checked]) for (const name of set) if (!names.has(name)) set.delete(name);
  app.alone = app.alone.filter((name) => names.has(name));
  $("isolate").setAttribute("aria-pressed", app.alone.length > 0);
  tree();
  const [undo, redo] = app.doc.segment_steps;
  $("segments-undo").disabled = !undo;
  $("segments-redo").disabled = !redo;
  $("segments-undo").title = undo ? `Undo: ${undo}` : "Nothing to undo";
  $("segments-redo").title = redo ? `Redo: ${redo}` : "Nothing to redo";
  tell("document", app.doc);
  look(false);
}

let last = null; // the name that was checked or unchecked last
let names = []; // the names in the tree, from top to bottom

// with Shift, all from the last one to this one get the same state
function check(name, checked, range) {
  const [from, to] = [names.indexOf(last), names.indexOf(name)].sort((a, b) => a - b);
  const all = range && from >= 0 ? names.slice(from, to + 1) : [name];
  for (const each of all) checked ? app.checked.add(each) : app.checked.delete(each);
  last = name;
  if (all.length > 1) tree();
  tell("checked");
}

function tree() {
  const wanted = $("search").value.toLowerCase();
  const shown = app.doc.segments.filter((s) => s.name.toLowerCase().includes(wanted));
  names = shown.map((s) => s.name);
  const key = document.activeElement?.dataset.key;
  $("no-segments").hidden = app.doc.segments.length > 0;
  $("search").hidden = app.doc.segments.length < 8;
  $("tree").replaceChildren(...shown.map((s, number) => row(s, number, check)));
  // keyboard focus stays where it was
  if (key) $("tree").querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus();
}
$("search").oninput = tree;

// the checked segments; shows a message if there are none
export const chosen = () => {
  if (!app.checked.size) say("Check one or more segments first.", true);
  return [...app.checked];
};

$("coarse").onclick = async () => {
  const goes = !app.doc.segments.length || (await question("Segments found by colour replace all existing segments; undo brings those back.", { button: "find by colour" })) !== null;
  if (goes) change({ kind: "coarse", time: value("when"), clusters: null });
};
$("group").onclick = async () => {
  const segments = chosen();
  const name = segments.length && (await question(`Group ${segments.join(", ")} as one segment.`, { button: "group", name: true }));
  if (name) change({ kind: "group", name, segments });
};
$("remove").onclick = () => { const segments = chosen(); if (segments.length) change({ kind: "remove", segments }); };
$("isolate").onclick = () => {
  app.alone = app.alone.length ? [] : chosen();
  $("isolate").setAttribute("aria-pressed", app.alone.length > 0);
  look(false);
};
$("segments-undo").onclick = () => change({ kind: "segments", undo: true });
$("segments-redo").onclick = () => change({ kind: "segments", undo: false });

// hidden and isolated segments may have changed elsewhere
on("restored", () => {
  tree();
  $("isolate").setAttribute("aria-pressed", app.alone.length > 0);
});

hear("document", read);
