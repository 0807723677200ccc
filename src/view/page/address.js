// The view in the address, so that it can be shared. The secret is never there.
import { $, app, on, value } from "./state.js";
import { setTime } from "./time.js";

function toAddress() {
  const { eye, target, up, fov } = app.camera.state();
  // every digit, so that the picture is the same to the bit
  const of = new URLSearchParams({ eye: eye.join(","), target: target.join(","), up: up.join(","), fov, t: value("when"), look: $("look").value });
  history.replaceState(null, "", `#${of}`);
}

export function fromAddress() {
  const of = new URLSearchParams(location.hash.slice(1));
  const three = (name) => (of.get(name) ?? "").split(",").map(Number);
  const [eye, target, up, fov] = [three("eye"), three("target"), three("up"), Number(of.get("fov"))];
  if ([eye, target, up].every((v) => v.length === 3 && v.every(Number.isFinite)) && fov > 0) app.camera.restore({ eye, target, up, fov });
  const time = Number(of.get("t"));
  if (of.has("t") && time >= 0 && time <= 1) setTime(time);
  if ([...$("look").options].some((o) => o.value === of.get("look"))) $("look").value = of.get("look");
}

on("rested", toAddress);
