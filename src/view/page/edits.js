// Edits of the checked segments, and the list of edits.
import { $, make, value } from "./dom.js";
import { recolour } from "./operations.js";
import { chosen } from "./segments.js";
import { change } from "./socket.js";
import { on } from "./state.js";
import { scale, unit } from "./units.js";
/** @import { Operation } from "./protocol" */

/** @param {Operation} operation */
const edit = (operation) => {
  const segments = chosen();
  if (segments.length) change({ kind: "edit", segments, operation });
};

$("edits-undo").onclick = () => change({ kind: "edits", undo: true });
$("edits-redo").onclick = () => change({ kind: "edits", undo: false });
$("recolour").onclick = () => edit(recolour($("paint").value));
$("opacity").onclick = () => edit({ opacity: { factor: value("factor") } });
$("hide").onclick = () => edit("hide");
$("show").onclick = () => edit("show");
$("move").onclick = () => edit({ translate: { by: [value("dx") / scale(), value("dy") / scale(), value("dz") / scale()] } });
$("rotate").onclick = () => {
  /** @param {string} name */
  const part = (name) => Number($("axis").value === name);
  edit({ rotate: { axis: [part("x"), part("y"), part("z")], degrees: value("degrees"), about: null } });
};
$("enlarge").onclick = () => edit({ scale: { factor: value("size"), about: null } });

on("welcome", () => {
  $("move").title = `Move the checked segments by this offset (${unit("length")})`;
  for (const id of /** @type {const} */ (["dx", "dy", "dz"])) $(id).step = String(Number((0.05 * scale()).toPrecision(1)));
});
on("document", (doc) => {
  $("edits-count").textContent = doc.edits.length ? `(${doc.edits.length})` : "";
  $("edits").replaceChildren(...doc.edits.map((textContent) => make("li", { textContent })));
  [$("edits-undo").disabled, $("edits-redo").disabled] = [!doc.edit_steps[0], !doc.edit_steps[1]];
});
