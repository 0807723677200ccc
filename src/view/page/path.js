// A camera path: keyframes are listed here; the server interpolates between them.
import { $, app, make, on, say, value } from "./state.js";
import { ask } from "./socket.js";
import { look, narrowed, size, view } from "./picture.js";
import { restore } from "./address.js";
import { download } from "./take.js";
import { setTime } from "./time.js";
import { timeText } from "./units.js";

const RATE = 30; // cameras played per second
let keys = [];
let flight = null; // the cameras that are being played, and when that began

function show(key) {
  app.camera.restore({ ...key, fov: narrowed(key.fov, size()) });
  setTime(key.time);
}

function list() {
  $("keys").replaceChildren(...keys.map((key, n) => {
    const go = make("button", { textContent: `${n + 1}: ${key.seconds.toFixed(1)} s, time ${timeText(key.time)}`, title: "Show this keyframe" });
    go.onclick = () => { show(key); look(false); };
    const remove = make("button", { textContent: "×" });
    remove.setAttribute("aria-label", `Remove keyframe ${n + 1}`);
    remove.onclick = () => {
      keys.splice(n, 1);
      list();
      $("key-add").focus();
    };
    return make("li", { className: "row" }, go, remove);
  }));
  for (const id of ["path-play", "path-save"]) $(id).disabled = keys.length < 2;
}

$("key-add").onclick = () => {
  const { eye, target, up, fov, time } = view(false);
  const last = keys.at(-1);
  keys.push({ seconds: last ? last.seconds + Math.max(0.1, value("key-gap") || 2) : 0, time, eye, target, up, fov });
  list();
};

const wanted = (frames) => ask({ type: "path", keys, frames }).catch((message) => say(message, true));

function stop() {
  flight = null;
  $("path-play").textContent = "play path";
  look(false);
}
// shows the camera that is due now: a slow machine skips some and keeps the speed
function step() {
  const n = Math.round(((performance.now() - flight.from) / 1000) * RATE);
  show(flight.frames[Math.min(n, flight.frames.length - 1)]);
  if (n >= flight.frames.length) return stop();
  if (!look(true)) setTimeout(() => flight && step(), 15);
}
$("path-play").onclick = async () => {
  if (flight) return stop();
  const seconds = keys.at(-1).seconds - keys[0].seconds;
  const answer = await wanted(Math.min(3000, Math.ceil(seconds * RATE) + 1));
  if (!answer) return;
  flight = { frames: answer.frames, from: performance.now() };
  $("path-play").textContent = "stop";
  step();
};
$("path-save").onclick = async () => {
  look(false);
  const answer = await wanted(0);
  if (!answer) return;
  download(new Blob([JSON.stringify(answer.file, null, 1)], { type: "application/json" }), "path.json");
  say(`To render it: ${answer.file.command}`);
};

on("frame", () => flight && step());
// a path file was opened; the server checks its keyframes
on("path", async (file) => {
  const before = keys;
  keys = file.keys;
  const answer = await wanted(0);
  if (!answer) keys = before;
  else {
    restore({ ...file.view, ...keys[0], size: size() });
    say(`Opened a path of ${keys.length} keyframes.`);
  }
  list();
});
