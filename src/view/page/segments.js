// The tree of segments.
import { $, app, make, on, say, tell, value } from "./state.js";
import { ask, change, hear } from "./socket.js";
import { look, stale } from "./picture.js";

function read(message) {
  app.doc = message;
  stale();
  const names = new Set(app.doc.segments.map((s) => s.name));
  for (const set of [app.hidden, app.checked]) for (const name of set) if (!names.has(name)) set.delete(name);
  app.alone = app.alone.filter((name) => names.has(name));
  tree();
  const [undo, redo] = app.doc.segment_steps;
  $("segments-undo").disabled = !undo;
  $("segments-redo").disabled = !redo;
  $("segments-undo").title = undo ? `Undo: ${undo}` : "Nothing to undo";
  $("segments-redo").title = redo ? `Redo: ${redo}` : "Nothing to redo";
  tell("document", app.doc);
  look(false);
}

function tree() {
  const wanted = $("search").value.toLowerCase();
  const rows = app.doc.segments.filter((s) => s.name.toLowerCase().includes(wanted)).map((s) => {
    const row = make("li");
    row.style.paddingLeft = `${s.depth}em`;
    const box = make("input", { type: "checkbox", checked: app.checked.has(s.name) });
    box.setAttribute("aria-label", `Choose ${s.name}`);
    box.onchange = () => (box.checked ? app.checked.add(s.name) : app.checked.delete(s.name));
    const eye = make("button");
    const shown = () => {
      eye.textContent = app.hidden.has(s.name) ? "○" : "●";
      eye.setAttribute("aria-pressed", app.hidden.has(s.name));
    };
    eye.setAttribute("aria-label", `Leave ${s.name} out of the picture`);
    eye.title = "Leave it out of the picture; no edit";
    eye.onclick = () => {
      app.hidden.has(s.name) ? app.hidden.delete(s.name) : app.hidden.add(s.name);
      shown();
      look(false);
    };
    shown();
    const swatch = make("span", { className: "swatch" });
    swatch.style.background = `rgb(${s.colour.map((c) => Math.round(255 * Math.min(1, Math.max(0, c)))).join(" ")})`;
    const name = make("span", { className: "name", textContent: s.name });
    const count = make("span", { className: "count", textContent: s.gaussians.toLocaleString("en") });
    row.append(box, eye, swatch, name, count);
    return row;
  });
  $("tree").replaceChildren(...rows);
}
$("search").oninput = tree;

// the checked segments; says so if there are none
export const chosen = () => {
  if (!app.checked.size) say("Check one or more segments first.", true);
  return [...app.checked];
};

$("coarse").onclick = () => {
  if (!app.doc.segments.length || confirm("All segments are replaced (undo brings them back). Go on?")) change({ kind: "coarse", time: value("when"), clusters: null });
};
$("group").onclick = () => {
  const segments = chosen();
  const name = segments.length && prompt("Name of the group");
  if (name) ask({ type: "change", base: app.doc.revision, change: { kind: "group", name, segments } }).catch((e) => say(e, true));
};
$("remove").onclick = () => { const segments = chosen(); if (segments.length) change({ kind: "remove", segments }); };
$("isolate").onclick = () => {
  app.alone = app.alone.length ? [] : chosen();
  $("isolate").setAttribute("aria-pressed", app.alone.length > 0);
  look(false);
};
$("segments-undo").onclick = () => change({ kind: "segments", undo: true });
$("segments-redo").onclick = () => change({ kind: "segments", undo: false });

// what is left out or alone may have changed elsewhere
on("restored", () => {
  tree();
  $("isolate").setAttribute("aria-pressed", app.alone.length > 0);
});

hear("document", read);
