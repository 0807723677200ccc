// Edits of the checked segments, and the list of edits.
import { $, make, on, value } from "./state.js";
import { change } from "./socket.js";
import { chosen } from "./segments.js";
import { scale, unit } from "./units.js";

const edit = (operation) => { const segments = chosen(); if (segments.length) change({ kind: "edit", segments, operation }); };

$("edits-undo").onclick = () => change({ kind: "edits", undo: true });
$("edits-redo").onclick = () => change({ kind: "edits", undo: false });
$("recolour").onclick = () => {
  const rgb = [1, 3, 5].map((k) => parseInt($("paint").value.slice(k, k + 2), 16) / 255);
  edit({ recolour: { rgb, keep_shading: true } });
};
$("opacity").onclick = () => edit({ opacity: { factor: value("factor") } });
$("hide").onclick = () => edit("hide");
$("show").onclick = () => edit("show");
$("move").onclick = () => edit({ translate: { by: ["dx", "dy", "dz"].map((id) => value(id) / scale()) } });
$("rotate").onclick = () => edit({ rotate: { axis: ["x", "y", "z"].map((a) => Number(a === $("axis").value)), degrees: value("degrees"), about: null } });
$("enlarge").onclick = () => edit({ scale: { factor: value("size"), about: null } });

on("welcome", () => {
  $("move").title = `Move the checked segments by this offset (${unit("length")})`;
  for (const id of ["dx", "dy", "dz"]) $(id).step = Number((0.05 * scale()).toPrecision(1));
});
on("document", (doc) => {
  $("edits-count").textContent = doc.edits.length ? `(${doc.edits.length})` : "";
  $("edits").replaceChildren(...doc.edits.map((textContent) => make("li", { textContent })));
  [$("edits-undo").disabled, $("edits-redo").disabled] = doc.edit_steps.map((there) => !there);
});
