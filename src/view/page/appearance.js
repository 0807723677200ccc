// Looks, colour scales, and views along the axes.
import { $, make } from "./dom.js";
import { requestView } from "./picture.js";
import { hear } from "./socket.js";
import { app, on, setRange } from "./state.js";
/** @import { Legend } from "./protocol" */
/** @import { Vec3 } from "./types" */

// palettes for magnitudes and for signed values; the first of each is the default
const MAGNITUDES = ["viridis", "cividis", "inferno"];
const SIGNED = ["cool-warm", "red-green"];
/** @param {string} look */
const palettes = (look) => (/^velocity [xyz]$/.test(look) ? SIGNED : look === "depth" || look === "velocity speed" ? MAGNITUDES : []);

/** @param {string | null} [chosen] */
function offer(chosen) {
  const names = palettes($("look").value);
  /** @param {string} name */
  const text = (name) => (name === "red-green" ? "red-green, as in the paper" : name);
  $("palette").replaceChildren(...names.map((value) => make("option", { value, textContent: text(value) })));
  if (chosen && names.includes(chosen)) $("palette").value = chosen;
  $("palette-row").hidden = !names.length;
  $("hold").checked = Boolean(app.range);
}

// each look has its own scale
$("look").onchange = () => { setRange(null); offer(); requestView(false); };
$("palette").onchange = () => requestView(false);
on("restored", offer);

on("welcome", ({ clicks }) => {
  for (const option of $("look").options) if (option.value === "affinity") option.disabled = !clicks;
});

/** @type {Legend | null} */
let legend = null;
/** @param {number} v */
const short = (v) => Number(v.toPrecision(4)).toString();
hear("legend", (message) => {
  legend = message.legend;
  const range = legend?.range, scale = legend?.scale ?? [];
  $("legend-text").textContent = legend?.legend ?? "";
  $("legend-bar").hidden = !range || !scale.length;
  $("hold-row").hidden = !range;
  $("hold").checked = Boolean(app.range);
  if (!range || !scale.length) return;
  $("legend-colours").style.background = `linear-gradient(to right, ${scale.map((c) => `rgb(${c.join(" ")})`).join(", ")})`;
  const middle = (range[0] + range[1]) / 2;
  $("legend-numbers").replaceChildren(...[range[0], middle, range[1]].map((v) => make("span", { textContent: short(v) })));
});
$("hold").onchange = () => {
  // views hold the limits in scene units
  setRange($("hold").checked ? legend?.scene_range ?? null : null);
  requestView(false);
};
$("reset").onclick = () => { app.camera?.reset(); requestView(false); };
for (const button of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-axis]"))) {
  const axis = /** @type {Vec3} */ ((button.dataset.axis ?? "").split(",").map(Number));
  button.onclick = () => { app.camera?.lookFrom(axis); requestView(false); };
}
