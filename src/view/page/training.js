// The training of the run: its progress and curves, and which step is shown. A training in the viewer's own process can
// be paused.
import { $, say } from "./dom.js";
import { wasKept } from "./panels.js";
import { plot } from "./plot.js";
import { attempt, hear } from "./socket.js";
import { app, on } from "./state.js";
import { count, duration } from "./units.js";
/** @import { Progress, TrainingStatus } from "./protocol" */
/** @import { Vec2 } from "./types" */

/** @type {TrainingStatus | null} */
let training = null;

/** Describes the scene that is shown. @param {number} gaussians @param {number | null} step */
export function describe(gaussians, step) {
  const at = step === null ? "" : `, step ${count(step)}`;
  const readOnly = app.welcome?.read_only && !app.welcome.in_training;
  $("scene").textContent = `${count(gaussians)} Gaussians${at}${readOnly ? ", read-only" : ""}`;
}

/**
 * Shows the progress of a training in the viewer's own process.
 * @param {Progress} now
 * @param {Progress | undefined} before
 */
function showLive({ pace, left, loss, pausing, paused, shown, gaussians }, before) {
  const parts = [pace === null ? "" : `${pace.toPrecision(3)} steps/s`, left === null || paused ? "" : `${duration(left)} left`];
  $("live-figures").textContent = [...parts, loss === null ? "" : `loss ${loss.toFixed(4)}`].filter(Boolean).join(", ");
  $("pause").textContent = pausing ? "resume" : "pause";
  $("pause").title = pausing ? "Resume the training" : "Pause the training after the current step";
  $("pause").disabled = !app.welcome?.can_pause;
  if (app.welcome) describe(gaussians, shown);
  if (before && paused !== before.paused) say(paused ? "The training is paused." : "");
}

/** @param {TrainingStatus | null} [before] */
function show(before) {
  if (!training) return;
  const { status, steps, all, loss, train, test, live } = training;
  const done = steps === all ? count(all) : `${count(steps)} of ${count(all)}`;
  const step = live?.shown ?? app.welcome?.step ?? null;
  const now = !live || !live.pausing ? status : live.paused ? "paused" : "pausing";
  // for a complete training, the shown step is named only if it is not the last
  const shown = step === null || (step === all && steps === all) ? "" : `; step ${count(step)} is shown`;
  $("training-figures").textContent = `Training: ${now}, ${done} steps${shown}`;
  $("live").hidden = !live;
  if (live) showLive(live, before?.live ?? undefined);
  $("training-note").hidden = status !== "broken off";
  /** @type {Vec2} */
  const span = [0, steps];
  plot($("training-loss"), [{ points: loss }], { span });
  plot($("training-psnr"), [{ points: train, look: "one" }, { points: test, look: "two" }], { span, unit: " dB" });
  /** @param {Vec2[]} curve @param {string} views */
  const last = (curve, views) => `${curve[curve.length - 1][1].toFixed(2)} dB on ${views} views`;
  const ends = [...(train.length ? [last(train, "training")] : []), ...(test.length ? [last(test, "test")] : [])];
  $("training-psnr").setAttribute("aria-label", train.length ? `PSNR by step: at the end ${ends.join(", ")}` : "PSNR by step");
  $("training").hidden = false;
}

hear("training", (message) => {
  const before = training;
  training = message;
  show(before);
});
on("welcome", ({ in_training: live }) => {
  if (live && !wasKept("training")) $("training").open = true;
  show();
});
$("pause").onclick = () => training?.live && attempt({ type: "pause", pause: !training.live.pausing });
