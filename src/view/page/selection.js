// Clicks: the selection, its levels and sliders, and segments made from it.
import { $, canvas, make, say, value } from "./dom.js";
import { reveal } from "./panels.js";
import { requestView, stale } from "./picture.js";
import { attempt, hear, send } from "./socket.js";
import { app, on, setPicked } from "./state.js";
import { count } from "./units.js";
/** @import { LevelKind, RequestedGranularity, Selected } from "./protocol" */
/** @import { Unnumbered, Vec2 } from "./types" */

/**
 * What makes the Gaussians of a level one; the share is that of what the scene shows.
 * @type {Record<LevelKind, string>}
 */
const KINDS = {
  similar: "What is similar to the click",
  part: "The clicked part of the connected piece",
  piece: "The connected piece of the segment at the click",
  segment: "The whole segment, such as all of this colour",
  object: "The clicked part with what belongs to it of other segments",
};
const HINT = "Click on the picture to select. Shift-click adds, Alt-click removes.";

/** The pixel under the pointer. @param {MouseEvent} e @returns {Vec2} */
function under(e) {
  const box = canvas.getBoundingClientRect();
  const x = (e.clientX - box.left) / box.width, y = (e.clientY - box.top) / box.height;
  // the comparison picture shows the same place
  return [Math.floor((x >= 1 ? x - 1 : x) * canvas.width), Math.floor(y * canvas.height)];
}

/** Makes the clicked point the target, about which the camera turns. @param {MouseEvent} e */
export async function centreOn(e) {
  const found = await attempt({ type: "point", pixel: under(e) });
  if (!found) return;
  say("");
  app.camera?.centreOn(found.at);
  requestView(false);
}

/** @param {PointerEvent} e */
export async function click(e) {
  const pixel = under(e);
  const stage = $("stage").getBoundingClientRect();
  Object.assign($("marker").style, { left: `${e.clientX - stage.left}px`, top: `${e.clientY - stage.top}px` });
  $("marker").hidden = false;
  requestView(false);
  const combine = e.shiftKey ? "add" : e.altKey ? "remove" : "replace";
  await choose({ type: "pick", pixel, within: null, meaning: null, combine });
}

// grows when the selection is cleared; what was asked for before that is not shown
let clears = 0;
/** @param {Unnumbered<"pick"> | Unnumbered<"adjust">} request */
async function choose(request) {
  const before = clears;
  const found = await attempt(request);
  if (found && clears === before) selected(found);
}

/** @param {Selected} message */
function selected(message) {
  setPicked(message);
  stale();
  say("");
  const names = message.segments.length ? ` in ${message.segments.join(", ")}` : "";
  $("selected").textContent = `${count(message.gaussians)} Gaussians${names} (${message.ms.toFixed(0)} ms)`;
  $("levels").replaceChildren(...message.levels.map(({ kind, share }, n) => {
    const percent = share < 0.1 ? (100 * share).toFixed(1) : (100 * share).toFixed(0);
    const button = make("button", { textContent: `${kind} ${percent} %`, title: KINDS[kind] });
    button.setAttribute("aria-pressed", String(n + 1 === message.level));
    button.onclick = () => adjust({ level: n + 1 });
    return button;
  }));
  $("scale").value = String(message.scale);
  $("cosine").value = String(Math.max(0, message.threshold));
  figures();
  reveal($("refine"));
}

// shows the values of the sliders
function figures() {
  for (const id of /** @type {const} */ (["scale", "cosine"])) $(`${id}-now`).textContent = value(id).toFixed(2);
}

// one adjustment is under way at a time; of those that wait, the latest wins
let adjusting = false;
/** @type {RequestedGranularity | null} */
let next = null;
/** @param {RequestedGranularity} meaning */
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
  setPicked(null);
  next = null;
  clears += 1;
  stale();
  $("marker").hidden = true;
  $("refine").hidden = true;
  $("levels").replaceChildren();
  if (app.welcome?.clicks) $("selected").textContent = HINT;
  send({ type: "clear" });
}
$("clear").onclick = clear;
$("commit").onsubmit = async (e) => {
  e.preventDefault();
  const name = $("name").value.trim();
  if (!app.picked) return say("Click on something first.", true);
  if (!name) return say("Enter a name for the segment.", true);
  const committed = app.picked;
  if (!(await attempt({ type: "commit", base: app.doc.revision, name }))) return;
  $("name").value = "";
  // a click made meanwhile stays
  if (app.picked === committed) clear();
  say(`${name} is now a segment.`);
};

// the next connection does not know the selection
hear("closed", () => app.picked && clear());
/** @type {string | null} */
let scene = null;
on("welcome", (welcome) => {
  // the selection belongs to the previous scene
  if (app.picked && scene !== welcome.scene) clear();
  scene = welcome.scene;
  if (app.picked) return;
  $("selected").textContent = welcome.clicks ? HINT : "To select by clicks, first make masks and train the affinity field (below).";
});
