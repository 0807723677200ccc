// Time: the slider, steps and playback.
import { $, value } from "./dom.js";
import { requestView } from "./picture.js";
import { STEP, timeDue } from "./playback.js";
import { app, on, setPlaying } from "./state.js";
import { timeText } from "./units.js";

function label() {
  $("now").value = timeText(value("when"));
  $("when").setAttribute("aria-valuetext", $("now").value);
  $("now").title = `${value("when").toFixed(3)} from the first (0) to the last time of the data (1)`;
}
/** @param {number} t */
export function setTime(t) {
  $("when").value = String(t);
  label();
}
/** @param {number} steps */
export function nudge(steps) {
  setTime(Math.min(1, Math.max(0, value("when") + steps * STEP)));
  requestView(true);
}
/** @param {number} t */
export function goTo(t) {
  setTime(t);
  requestView(false);
}
/** Starts or stops the playback. */
export function play() {
  setPlaying(app.playing ? null : { from: performance.now(), at: value("when") % 1 });
  $("play").textContent = app.playing ? "⏸" : "▶";
  $("play").setAttribute("aria-label", app.playing ? "Stop" : "Play");
  if (app.playing) step();
  else requestView(false);
}
// shows the time that is due now, once a frame has arrived
function step() {
  if (!app.playing) return;
  const t = timeDue(app.playing, performance.now(), value("speed") || 5, $("loop").checked);
  setTime(t ?? 1);
  if (t === null) return play();
  if (!requestView(true)) setTimeout(step, 15);
}
$("play").onclick = play;
$("back").onclick = () => nudge(-1);
$("forth").onclick = () => nudge(1);
$("when").oninput = () => { label(); requestView(true); };
$("when").onchange = () => requestView(false);

on("frame", step);
on("welcome", label);
