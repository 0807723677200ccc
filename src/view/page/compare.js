// Comparison: a second picture beside the first, over it right of a divider, or in its place.
import { $, canvas, context2d, make, say, value } from "./dom.js";
import { restore } from "./address.js";
import { requestView, restingView, shown, size } from "./picture.js";
import { ask, hear } from "./socket.js";
import { app, on, setComparison } from "./state.js";
import { count, timeText } from "./units.js";
/** @import { Compare, Placed } from "./protocol" */
/** @import { Welcome } from "./types" */

const other = $("other");
const context = context2d(other);
/** @type {Placed[]} */
let views = []; // test views of the dataset
/** @type {{ bitmap: ImageBitmap, number: number } | null} */
let image = null; // the dataset's image, and the number of its view
let flipped = false;
/** @type {string | null} */
let fault = null; // why there is no picture to compare with

const chosen = () => $("compare").value;
/** The number of the chosen other run, or null. */
const runNumber = () => (chosen().startsWith("run ") ? Number(chosen().slice(4)) : null);
const otherRun = () => app.welcome?.others[runNumber() ?? NaN];

/** @returns {Compare | null} */
function comparison() {
  const run = runNumber();
  if (run !== null) return { with: "run", run };
  switch (chosen()) {
    case "image": return views.length ? { with: "image", view: value("test-view") } : null;
    case "time": return { with: "time", time: value("other-time") };
    case "plain": return { with: "plain" };
    default: return null;
  }
}

function update() {
  setComparison(comparison());
  layout();
  requestView(false);
}

/** What the other picture shows, in words. */
function otherName() {
  const run = otherRun();
  if (run) return `${run.name}${run.step === null ? "" : `, step ${count(run.step)}`}`;
  if (chosen() === "image") return `the dataset's image of view ${value("test-view")}`;
  return chosen() === "plain" ? "without edits" : `time ${timeText(value("other-time"))}`;
}

function layout() {
  const how = app.compare ? $("compare-how").value : "";
  for (const name of ["side", "wipe", "flip"]) $("stage").classList.toggle(name, how === name);
  other.hidden = !app.compare || (how === "flip" && !flipped);
  $("divider").hidden = how !== "wipe";
  $("compare-flip").disabled = how !== "flip";
  $("compare-flip").setAttribute("aria-pressed", String(flipped));
  $("other-time-row").hidden = chosen() !== "time";
  const where = how === "side" ? "Right" : how === "wipe" ? "Right of the divider" : flipped ? "Shown" : "Behind";
  const note = otherRun()?.note;
  $("compared").textContent = app.compare ? `${where}: ${otherName()}${fault ? `: ${fault}` : ""}` : "";
  $("compared").classList.toggle("wrong", Boolean(app.compare && fault));
  $("compare-note").textContent = note ? `${otherRun()?.name}: ${note}.` : "";
  $("compare-note").hidden = !note;
  showImage();
}

function fit() {
  const [w, h] = size();
  if (other.width !== w || other.height !== h) [other.width, other.height] = [w, h];
  return [w, h];
}

// draws the image at the scale of the picture
function showImage() {
  if (app.compare?.with !== "image") return;
  const [w, h] = fit();
  context.clearRect(0, 0, w, h);
  const [test, now] = [views[app.compare.view], restingView()];
  if (image?.number !== app.compare.view || !test || !now) return;
  /** @param {number} fov */
  const half = (fov) => Math.tan(fov / 2);
  const wide = (w * half(test.fov)) / half(now.fov);
  const tall = (wide * image.bitmap.height) / image.bitmap.width;
  context.drawImage(image.bitmap, (w - wide) / 2, (h - tall) / 2, wide, tall);
  other.dataset.image = String(image.number);
}

on("other", ({ bitmap, number, isImage }) => {
  if (isImage) {
    image?.bitmap.close();
    image = { bitmap, number };
    return showImage();
  }
  const [w, h] = fit();
  context.drawImage(bitmap, 0, 0, w, h);
  other.dataset.frame = String(number);
  bitmap.close();
});
on("frame", showImage);

// an outdated picture must not remain visible
hear("beside", (message) => {
  fault = message.fault;
  if (fault) context.clearRect(0, 0, other.width, other.height);
  layout();
});

function goToTestView() {
  const test = views[value("test-view")];
  if (!test) return say("The dataset has no test views.", true);
  restore({ ...test, ...shown() });
  update();
}
$("test-view").onchange = goToTestView;
$("snap").onclick = goToTestView;
$("compare").onchange = () => (chosen() === "image" ? goToTestView() : update());
$("compare-how").onchange = () => { flipped = false; update(); };
$("other-time").oninput = update;
export function flip() {
  if ($("compare-flip").disabled) return;
  flipped = !flipped;
  layout();
}
$("compare-flip").onclick = flip;

/** Moves the divider. @param {number} percent of the width */
function divide(percent) {
  const to = Math.min(100, Math.max(0, percent));
  $("divider").style.left = `${to}%`;
  $("divider").setAttribute("aria-valuenow", String(Math.round(to)));
  $("stage").style.setProperty("--divider", `${to}%`);
}
$("divider").onpointerdown = (e) => $("divider").setPointerCapture(e.pointerId);
$("divider").onpointermove = (e) => {
  const box = $("stage").getBoundingClientRect();
  if (e.buttons) divide((100 * (e.clientX - box.left)) / box.width);
};
$("divider").onkeydown = (e) => {
  const by = e.key === "ArrowLeft" ? -2 : e.key === "ArrowRight" ? 2 : 0;
  if (!by) return;
  e.preventDefault();
  e.stopPropagation();
  divide(Number($("divider").getAttribute("aria-valuenow")) + by);
};
divide(50);
// pointer and wheel events on the second picture act on both
other.addEventListener("pointerdown", (e) => {
  e.preventDefault();
  canvas.dispatchEvent(new PointerEvent("pointerdown", e));
});
other.addEventListener("wheel", (e) => {
  e.preventDefault();
  canvas.dispatchEvent(new WheelEvent("wheel", e));
});
other.addEventListener("contextmenu", (e) => e.preventDefault());

hear("views", (message) => {
  views = message.views;
  const options = views.map((v, n) => make("option", { value: String(n), textContent: `${n}: time ${timeText(v.time)}` }));
  $("test-view").replaceChildren(...options);
});

/** @param {Welcome} welcome */
function offer({ others }) {
  const before = chosen();
  $("compare-runs").replaceChildren(...others.map((run, n) => make("option", { value: `run ${n}`, textContent: run.name })));
  $("compare-runs").hidden = !others.length;
  $("compare").value = before;
  if (chosen() !== before) $("compare").value = "";
  layout();
}
on("welcome", async (welcome) => {
  // a restarted viewer has reported no fault yet
  fault = null;
  offer(welcome);
  if (views.length) return;
  // a run whose dataset is missing has no test views
  await ask({ type: "views" }).catch(() => {});
  $("snap").disabled = $("test-view").disabled = !views.length;
});
