// Clicks: the selection, its levels and sliders, and segments made from it.
import { $, app, canvas, make, on, say, tell, value } from "./state.js";
import { ask, hear, send } from "./socket.js";
import { look, stale } from "./picture.js";
import { add, sub } from "./camera.js";
import { reveal } from "./parts.js";

// what makes the Gaussians of a level one; the share is that of what the scene shows
const KINDS = {
  similar: "What is similar to the click",
  part: "The clicked part of the connected piece",
  piece: "The connected piece of the segment at the click",
  segment: "The whole segment, such as all of this colour",
  object: "The clicked part with what belongs to it of other segments",
};
const HINT = "Click on the picture to select. Shift-click adds, Alt-click removes.";

// the pixel under the pointer
function under(e) {
  const box = canvas.getBoundingClientRect();
  const at = [(e.clientX - box.left) / box.width, (e.clientY - box.top) / box.height];
  // the comparison picture shows the same place
  if (at[0] >= 1) at[0] -= 1;
  return at.map((v, k) => Math.floor(v * [canvas.width, canvas.height][k]));
}

// makes the clicked point the target, about which the camera turns
export async function centreOn(e) {
  const found = await ask({ type: "point", pixel: under(e) }).catch((message) => say(message, true));
  if (!found) return;
  say("");
  const arm = sub(app.camera.eye, app.camera.target);
  Object.assign(app.camera, { target: found.at, eye: add(found.at, arm) });
  look(false);
}

export async function click(e) {
  const pixel = under(e);
  const stage = $("stage").getBoundingClientRect();
  Object.assign($("marker").style, { left: `${e.clientX - stage.left}px`, top: `${e.clientY - stage.top}px` });
  $("marker").hidden = false;
  look(false);
  const combine = e.shiftKey ? "add" : e.altKey ? "remove" : "replace";
  await choose({ type: "pick", pixel, within: null, meaning: null, combine });
}

// grows when the selection is cleared; what was asked for before that is not shown
let clears = 0;
async function choose(request) {
  const before = clears;
  const found = await ask(request).catch((message) => say(message, true));
  if (!found || clears !== before) return;
  selected(found);
  tell("picked", found);
}

function selected(message) {
  app.picked = message;
  stale();
  say("");
  const names = message.segments.length ? ` in ${message.segments.join(", ")}` : "";
  $("selected").textContent = `${message.gaussians.toLocaleString("en")} Gaussians${names} (${message.ms.toFixed(0)} ms)`;
  $("levels").replaceChildren(...message.levels.map(({ kind, share }, n) => {
    const percent = share < 0.1 ? (100 * share).toFixed(1) : (100 * share).toFixed(0);
    const button = make("button", { textContent: `${kind} ${percent} %`, title: KINDS[kind] });
    button.setAttribute("aria-pressed", n + 1 === message.level);
    button.onclick = () => adjust({ level: n + 1 });
    return button;
  }));
  $("scale").value = message.scale;
  $("cosine").value = Math.max(0, message.threshold);
  figures();
  reveal($("refine"));
}

// shows the values of the sliders
function figures() {
  for (const id of ["scale", "cosine"]) $(`${id}-now`).textContent = value(id).toFixed(2);
}

// one adjustment is under way at a time; of those that wait, the latest wins
let adjusting = false, next = null;
async function adjust(meaning) {
  if (!app.picked) return;
  if (adjusting) { next = meaning; return; }
  adjusting = true;
  await choose({ type: "adjust", meaning });
  adjusting = false;
  if (next) { const m = next; next = null; adjust(m); }
}
const byHand = () => {
  figures();
  adjust({ by: { scale: value("scale"), threshold: value("cosine") } });
};
$("scale").oninput = byHand;
$("cosine").oninput = byHand;

export function clear() {
  app.picked = null;
  next = null;
  clears += 1;
  stale();
  $("marker").hidden = true;
  $("refine").hidden = true;
  $("levels").replaceChildren();
  if (app.welcome?.clicks) $("selected").textContent = HINT;
  send({ type: "clear" });
  tell("cleared");
}
$("clear").onclick = clear;
$("commit").onsubmit = async (e) => {
  e.preventDefault();
  const name = $("name").value.trim();
  if (!app.picked) return say("Click on something first.", true);
  if (!name) return say("Enter a name for the segment.", true);
  const committed = app.picked;
  await ask({ type: "commit", base: app.doc.revision, name }).then(() => {
    $("name").value = "";
    // a click made meanwhile stays
    if (app.picked === committed) clear();
    say(`${name} is now a segment.`);
  }).catch((message) => say(message, true));
};

// the next connection does not know the selection
hear("closed", () => app.picked && clear());
let scene = null;
on("welcome", (welcome) => {
  // the selection belongs to the previous scene
  if (app.picked && scene !== welcome.scene) clear();
  scene = welcome.scene;
  if (app.picked) return;
  $("selected").textContent = welcome.clicks ? HINT : "To select by clicks, first make masks and train the affinity field (below).";
});
