// Time: the slider, steps and playback.
import { $, app, on, value } from "./state.js";
import { look } from "./picture.js";
import { timeText } from "./units.js";

const STEP = 0.01;
function label() {
  $("now").value = timeText(value("when"));
  $("when").setAttribute("aria-valuetext", $("now").value);
  $("now").title = `${value("when").toFixed(3)} from the first (0) to the last time of the data (1)`;
}
export function setTime(t) {
  $("when").value = t;
  label();
}
export function nudge(by) {
  setTime(Math.min(1, Math.max(0, value("when") + by * STEP)));
  look(true);
}
export function goTo(t) {
  setTime(t);
  look(false);
}
export function play() {
  app.playing = app.playing ? null : { from: performance.now(), at: value("when") % 1 };
  $("play").textContent = app.playing ? "⏸" : "▶";
  $("play").setAttribute("aria-label", app.playing ? "Stop" : "Play");
  if (app.playing) step();
  else look(false);
}
// shows the time that is due now, once a frame has arrived: a slow machine skips times and keeps the speed
function step() {
  const passed = (performance.now() - app.playing.from) / 1000 / Math.max(1, Number($("speed").value) || 5);
  let t = app.playing.at + passed;
  if (t > 1 && !$("loop").checked) {
    setTime(1);
    return play();
  }
  // on a grid, so that the second loop finds the cached Gaussians of the first
  setTime(Math.round((t % 1) / STEP) * STEP);
  if (!look(true)) setTimeout(() => app.playing && step(), 15);
}
$("play").onclick = play;
$("back").onclick = () => nudge(-1);
$("forth").onclick = () => nudge(1);
$("when").oninput = () => { setTime($("when").value); look(true); };
$("when").onchange = () => look(false);

on("frame", () => app.playing && step());
on("welcome", label);
