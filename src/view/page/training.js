// How the training of the run has come on: its curves, and which step is shown.
import { $, app, on } from "./state.js";
import { hear } from "./socket.js";
import { plot } from "./plot.js";

let training = null;

const count = (n) => n.toLocaleString("en");

function show() {
  if (!training) return;
  const { status, steps, all, loss, train, test } = training;
  const done = steps === all ? count(all) : `${count(steps)} of ${count(all)}`;
  const step = app.welcome?.step;
  // a training that is complete is what is shown, unless another step is
  const shown = step == null || (step === all && steps === all) ? "" : `; step ${count(step)} is shown`;
  $("training-figures").textContent = `Training: ${status}, ${done} steps${shown}`;
  $("training-note").hidden = status !== "broken off";
  const span = [0, steps];
  plot($("training-loss"), [{ points: loss }], { span });
  plot($("training-psnr"), [{ points: train, look: "one" }, { points: test, look: "two" }], { span, unit: " dB" });
  const last = test.length ? `, ${test.at(-1)[1].toFixed(2)} dB on test views` : "";
  $("training-psnr").setAttribute("aria-label", train.length ? `PSNR by step: at the end ${train.at(-1)[1].toFixed(2)} dB on views trained on${last}` : "PSNR by step");
  $("training").hidden = false;
}

hear("training", (message) => { training = message; show(); });
on("welcome", show);
