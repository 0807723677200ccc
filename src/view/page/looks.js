// Looks, colour scales, and views along the axes.
import { $, app, make, on } from "./state.js";
import { hear } from "./socket.js";
import { look } from "./picture.js";

// palettes for magnitudes and for signed values; the first of each is the default
const MAGNITUDES = ["viridis", "cividis", "inferno"];
const SIGNED = ["cool-warm", "red-green"];
const palettes = (shown) => (/^velocity [xyz]$/.test(shown) ? SIGNED : shown === "depth" || shown === "velocity speed" ? MAGNITUDES : []);

function offer(chosen) {
  const names = palettes($("look").value);
  const text = (name) => (name === "red-green" ? "red-green, as in the paper" : name);
  $("palette").replaceChildren(...names.map((value) => make("option", { value, textContent: text(value) })));
  if (names.includes(chosen)) $("palette").value = chosen;
  $("palette-row").hidden = !names.length;
  $("hold").checked = Boolean(app.range);
}

// each look has its own scale
$("look").onchange = () => { app.range = null; offer(); look(false); };
$("palette").onchange = () => look(false);
on("restored", offer);

on("welcome", ({ clicks }) => { document.querySelector("#look option[value=affinity]").disabled = !clicks; });

let legend = null;
const short = (v) => Number(v.toPrecision(4)).toString();
hear("legend", (message) => {
  legend = message.legend;
  const [range, scale] = [legend?.range, legend?.scale ?? []];
  $("legend-text").textContent = legend?.legend ?? "";
  $("legend-bar").hidden = !range || !scale.length;
  $("hold-row").hidden = !range;
  $("hold").checked = Boolean(app.range);
  if ($("legend-bar").hidden) return;
  $("legend-colours").style.background = `linear-gradient(to right, ${scale.map((c) => `rgb(${c.join(" ")})`).join(", ")})`;
  const middle = (range[0] + range[1]) / 2;
  $("legend-numbers").replaceChildren(...[range[0], middle, range[1]].map((v) => make("span", { textContent: short(v) })));
});
$("hold").onchange = () => {
  // views hold the limits in scene units
  app.range = $("hold").checked ? legend?.scene_range ?? null : null;
  look(false);
};
$("reset").onclick = () => { app.camera.reset(); look(false); };
for (const button of document.querySelectorAll("[data-axis]")) {
  button.onclick = () => {
    const { centre, radius, fov } = app.camera.home;
    app.camera.fov = fov;
    app.camera.look(centre, button.dataset.axis.split(",").map(Number), radius);
    look(false);
  };
}
