// Comparison: a second picture beside the first, over it right of a divider, or in its place.
import { $, app, canvas, make, on, say, value } from "./state.js";
import { ask, hear } from "./socket.js";
import { look, size, view } from "./picture.js";
import { restore } from "./address.js";
import { timeText } from "./units.js";

const other = $("other");
const context = other.getContext("2d");
let views = []; // test views of the dataset
let image = null; // the dataset's image, and the number of its view
let flipped = false;
let fault = null; // why there is no picture to compare with

const withWhat = () => $("compare").value;
// the number of the chosen other run, or null
const number = () => (withWhat().startsWith("run ") ? Number(withWhat().slice(4)) : null);
const otherRun = () => app.welcome?.others[number()];

function update() {
  const what = withWhat();
  if (what === "image") app.compare = views.length ? { with: "image", view: value("test-view") } : null;
  else if (what === "time") app.compare = { with: "time", time: value("other-time") };
  else if (number() !== null) app.compare = { with: "run", run: number() };
  else app.compare = what ? { with: what } : null;
  layout();
  look(false);
}

function layout() {
  const how = app.compare ? $("compare-how").value : "";
  for (const name of ["side", "wipe", "flip"]) $("stage").classList.toggle(name, how === name);
  other.hidden = !app.compare || (how === "flip" && !flipped);
  $("divider").hidden = how !== "wipe";
  $("compare-flip").disabled = how !== "flip";
  $("compare-flip").setAttribute("aria-pressed", flipped);
  $("other-time-row").hidden = withWhat() !== "time";
  const names = { image: `the dataset's image of view ${value("test-view")}`, plain: "without edits", time: `time ${timeText(value("other-time"))}` };
  const place = { side: "Right", wipe: "Right of the divider", flip: flipped ? "Shown" : "Behind" }[how];
  const run = otherRun();
  const name = run ? `${run.name}${run.step == null ? "" : `, step ${run.step.toLocaleString("en")}`}` : names[withWhat()];
  $("compared").textContent = app.compare ? `${place}: ${name}${fault ? `: ${fault}` : ""}` : "";
  $("compared").classList.toggle("wrong", Boolean(app.compare && fault));
  $("compare-note").textContent = run?.note ? `${run.name}: ${run.note}.` : "";
  $("compare-note").hidden = !run?.note;
  showImage();
}

// draws the image at the scale of the picture
function showImage() {
  if (app.compare?.with !== "image") return;
  const [w, h] = size();
  if (other.width !== w || other.height !== h) [other.width, other.height] = [w, h];
  context.clearRect(0, 0, w, h);
  const seen = views[app.compare.view];
  if (image?.number !== app.compare.view || !seen) return;
  const half = (fov) => Math.tan(fov / 2);
  const wide = (w * half(seen.fov)) / half(view(false).fov);
  const tall = (wide * image.bitmap.height) / image.bitmap.width;
  context.drawImage(image.bitmap, (w - wide) / 2, (h - tall) / 2, wide, tall);
  other.dataset.image = image.number;
}

on("other", ({ bitmap, number, isImage }) => {
  if (isImage) {
    image?.bitmap.close();
    image = { bitmap, number };
    return showImage();
  }
  const [w, h] = size();
  if (other.width !== w || other.height !== h) [other.width, other.height] = [w, h];
  context.drawImage(bitmap, 0, 0, w, h);
  other.dataset.frame = number;
  bitmap.close();
});
on("frame", showImage);

// an outdated picture must not remain visible
hear("beside", (message) => {
  fault = message.fault;
  if (fault) context.clearRect(0, 0, other.width, other.height);
  layout();
});

function snap() {
  const seen = views[value("test-view")];
  if (!seen) return say("The dataset has no test views.", true);
  restore({ ...seen, look: $("look").value, palette: $("palette").value, alone: app.alone, hidden: app.hidden, edits: $("edits-on").checked, range: app.range });
  update();
}
$("test-view").onchange = snap;
$("snap").onclick = snap;
$("compare").onchange = () => (withWhat() === "image" ? snap() : update());
$("compare-how").onchange = () => { flipped = false; update(); };
$("other-time").oninput = update;
export function flip() {
  if ($("compare-flip").disabled) return;
  flipped = !flipped;
  layout();
}
$("compare-flip").onclick = flip;

// moves the divider to a percentage of the width
function divide(at) {
  const to = Math.min(100, Math.max(0, at));
  $("divider").style.left = `${to}%`;
  $("divider").setAttribute("aria-valuenow", Math.round(to));
  $("stage").style.setProperty("--divider", `${to}%`);
}
$("divider").onpointerdown = (e) => $("divider").setPointerCapture(e.pointerId);
$("divider").onpointermove = (e) => {
  const box = $("stage").getBoundingClientRect();
  if (e.buttons) divide((100 * (e.clientX - box.left)) / box.width);
};
$("divider").onkeydown = (e) => {
  const by = { ArrowLeft: -2, ArrowRight: 2 }[e.key];
  if (!by) return;
  e.preventDefault();
  e.stopPropagation();
  divide(Number($("divider").getAttribute("aria-valuenow")) + by);
};
divide(50);
// pointer and wheel events on the second picture act on both
for (const kind of ["pointerdown", "wheel"]) other.addEventListener(kind, (e) => {
  e.preventDefault();
  canvas.dispatchEvent(new e.constructor(kind, e));
});
other.oncontextmenu = (e) => e.preventDefault();

hear("views", ({ views: found }) => {
  views = found;
  $("test-view").replaceChildren(...views.map((v, n) => make("option", { value: n, textContent: `${n}: time ${timeText(v.time)}` })));
});
function offer({ others }) {
  const chosen = withWhat();
  $("compare-runs").replaceChildren(...others.map((run, n) => make("option", { value: `run ${n}`, textContent: run.name })));
  $("compare-runs").hidden = !others.length;
  $("compare").value = chosen;
  if (withWhat() !== chosen) $("compare").value = "";
  layout();
}
on("welcome", (welcome) => {
  // a restarted viewer has reported no fault yet
  fault = null;
  offer(welcome);
  // a run whose dataset is missing has no test views
  if (!views.length) ask({ type: "views" }).catch(() => {}).then(() => ($("snap").disabled = $("test-view").disabled = !views.length));
});
