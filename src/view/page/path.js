// A camera path: keyframes are listed here; the viewer interpolates between them.
import { $, make, say, value } from "./dom.js";
import { restore } from "./address.js";
import { trainingFov } from "./camera.js";
import { requestView, restingView, size } from "./picture.js";
import { cameraDue, secondsAfter } from "./playback.js";
import { download } from "./share.js";
import { attempt } from "./socket.js";
import { app, on } from "./state.js";
import { setTime } from "./time.js";
import { timeText } from "./units.js";
/** @import { Key } from "./protocol" */

const RATE = 30; // cameras played per second
/** @type {Key[]} */
let keys = [];
/** @type {{ frames: Key[], from: number } | null} */
let flight = null; // the cameras that are being played, and when that began

/** @param {Key} key */
function show(key) {
  if (!app.camera || !app.welcome) return;
  app.camera.restore({ ...key, fov: trainingFov(key.fov, size(), app.welcome.size) });
  setTime(key.time);
}

function list() {
  $("keys").replaceChildren(...keys.map((key, n) => {
    const textContent = `${n + 1}: ${key.seconds.toFixed(1)} s, time ${timeText(key.time)}`;
    const go = make("button", { textContent, title: "Show this keyframe" });
    go.onclick = () => { show(key); requestView(false); };
    const remove = make("button", { textContent: "×" });
    remove.setAttribute("aria-label", `Remove keyframe ${n + 1}`);
    remove.onclick = () => {
      keys.splice(n, 1);
      list();
      $("key-add").focus();
    };
    return make("li", { className: "row" }, go, remove);
  }));
  for (const id of /** @type {const} */ (["path-play", "path-save"])) $(id).disabled = keys.length < 2;
}

$("key-add").onclick = () => {
  const view = restingView();
  if (!view) return;
  const { eye, target, up, fov, time } = view;
  keys.push({ seconds: secondsAfter(keys, value("key-gap") || 2), time, eye, target, up, fov });
  list();
};

/** @param {number} frames number of cameras */
const requestPath = (frames) => attempt({ type: "path", keys, frames });

function stop() {
  flight = null;
  $("path-play").textContent = "play path";
  requestView(false);
}
// shows the camera that is due now, once a frame has arrived
function step() {
  if (!flight) return;
  const n = cameraDue(flight.from, performance.now(), RATE);
  show(flight.frames[Math.min(n, flight.frames.length - 1)]);
  if (n >= flight.frames.length) return stop();
  if (!requestView(true)) setTimeout(step, 15);
}
$("path-play").onclick = async () => {
  if (flight) return stop();
  const seconds = keys[keys.length - 1].seconds - keys[0].seconds;
  const answer = await requestPath(Math.min(3000, Math.ceil(seconds * RATE) + 1));
  if (!answer) return;
  flight = { frames: answer.frames, from: performance.now() };
  $("path-play").textContent = "stop";
  step();
};
$("path-save").onclick = async () => {
  requestView(false);
  const answer = await requestPath(0);
  if (!answer) return;
  download(new Blob([JSON.stringify(answer.file, null, 1)], { type: "application/json" }), "path.json");
  say(`To render it: ${answer.file.command}`);
};

on("frame", step);
// a path file was opened; the viewer checks its keyframes
on("path", async (file) => {
  const before = keys;
  keys = file.keys;
  const answer = await requestPath(0);
  if (!answer) keys = before;
  else {
    restore({ ...file.view, ...keys[0], size: size() });
    say(`Opened a path of ${keys.length} keyframes.`);
  }
  list();
});
