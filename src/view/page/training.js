// The training of the run: its progress and curves, and which step is shown. A training in the viewer's own process can
// be paused.
import { $, app, duration, on, say } from "./state.js";
import { ask, hear } from "./socket.js";
import { plot } from "./plot.js";
import { wasLeft } from "./parts.js";

let training = null;

const count = (n) => n.toLocaleString("en");

// describes the scene that is shown
export function describe(gaussians, step) {
  const { read_only: still, in_training: live } = app.welcome;
  const at = step == null ? "" : `, step ${count(step)}`;
  $("scene").textContent = `${count(gaussians)} Gaussians${at}${still && !live ? ", read-only" : ""}`;
}

// shows the progress of a training in the viewer's own process
function showLive({ pace, left, loss, pausing, paused, shown, gaussians }, was) {
  const parts = [pace == null ? "" : `${pace.toPrecision(3)} steps/s`, left == null || paused ? "" : `${duration(left)} left`];
  $("live-figures").textContent = [...parts, loss == null ? "" : `loss ${loss.toFixed(4)}`].filter(Boolean).join(", ");
  $("pause").textContent = pausing ? "resume" : "pause";
  $("pause").title = pausing ? "Resume the training" : "Pause the training after the current step";
  $("pause").disabled = !app.welcome?.can_pause;
  if (app.welcome) describe(gaussians, shown);
  if (was && paused !== was.paused) say(paused ? "The training is paused." : "");
}

function show(was) {
  if (!training) return;
  const { status, steps, all, loss, train, test, live } = training;
  const done = steps === all ? count(all) : `${count(steps)} of ${count(all)}`;
  const step = live?.shown ?? app.welcome?.step;
  const now = !live || !live.pausing ? status : live.paused ? "paused" : "pausing";
  // for a complete training, the shown step is named only if it is not the last
  const shown = step == null || (step === all && steps === all) ? "" : `; step ${count(step)} is shown`;
  $("training-figures").textContent = `Training: ${now}, ${done} steps${shown}`;
  $("live").hidden = !live;
  if (live) showLive(live, was?.live);
  $("training-note").hidden = status !== "broken off";
  const span = [0, steps];
  plot($("training-loss"), [{ points: loss }], { span });
  plot($("training-psnr"), [{ points: train, look: "one" }, { points: test, look: "two" }], { span, unit: " dB" });
  const last = test.length ? `, ${test.at(-1)[1].toFixed(2)} dB on test views` : "";
  $("training-psnr").setAttribute("aria-label", train.length ? `PSNR by step: at the end ${train.at(-1)[1].toFixed(2)} dB on training views${last}` : "PSNR by step");
  $("training").hidden = false;
}

hear("training", (message) => {
  const was = training;
  training = message;
  show(was);
});
on("welcome", ({ in_training: live }) => {
  if (live && !wasLeft("training")) $("training").open = true;
  show(null);
});
$("pause").onclick = () => ask({ type: "pause", pause: !training.live.pausing }).catch((message) => say(message, true));
