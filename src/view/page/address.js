// The view in the address, so that it can be shared. The secret is never part of it.
import { $, app, on, tell, value } from "./state.js";
import { look, narrowed } from "./picture.js";
import { setTime } from "./time.js";

function toAddress() {
  const { eye, target, up, fov } = app.camera.state();
  // all digits, so that the picture is bit-identical
  const of = new URLSearchParams({ eye: eye.join(","), target: target.join(","), up: up.join(","), fov, t: value("when"), look: $("look").value });
  if (app.alone.length) of.set("alone", app.alone.join(","));
  if (app.hidden.size) of.set("hidden", [...app.hidden].join(","));
  if (!$("edits-on").checked) of.set("edits", "0");
  if ($("palette").value) of.set("palette", $("palette").value);
  if (app.range) of.set("range", app.range.join(","));
  history.replaceState(null, "", `#${of}`);
}

// restores a view; its field of view is that of the whole picture if it has a size, otherwise that of a training image
export function restore({ eye, target, up, fov, size, time, look: shown, alone, hidden, edits, range, palette }) {
  app.camera.restore({ eye, target, up, fov: size ? narrowed(fov, size) : fov });
  if (time >= 0 && time <= 1) setTime(time);
  if ([...$("look").options].some((o) => o.value === shown)) $("look").value = shown;
  app.alone = alone;
  app.hidden = new Set(hidden);
  app.range = Array.isArray(range) && range.length === 2 && range.every(Number.isFinite) ? range : null;
  $("edits-on").checked = edits !== false;
  tell("restored", palette);
  look(false);
}

export function fromAddress() {
  const of = new URLSearchParams(location.hash.slice(1));
  const numbers = (name) => (of.get(name) || "x").split(",").map(Number);
  const names = (name) => (of.get(name) ?? "").split(",").filter(Boolean);
  const [eye, target, up, fov] = [numbers("eye"), numbers("target"), numbers("up"), Number(of.get("fov"))];
  if (![eye, target, up].every((v) => v.length === 3 && v.every(Number.isFinite)) || !(fov > 0)) return;
  const [alone, hidden, edits, range] = [names("alone"), names("hidden"), of.get("edits") !== "0", numbers("range")];
  restore({ eye, target, up, fov, time: of.has("t") ? Number(of.get("t")) : NaN, look: of.get("look"), palette: of.get("palette"), alone, hidden, edits, range });
}

on("rested", toAddress);
