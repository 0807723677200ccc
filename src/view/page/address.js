// The view in the address, so that it can be shared. The secret is never part of it.
import { $, value } from "./dom.js";
import { trainingFov } from "./camera.js";
import { requestView, shown } from "./picture.js";
import { app, emit, on, setAlone, setHidden, setRange } from "./state.js";
import { setTime } from "./time.js";
import { fromHash, isRange, toHash } from "./view-text.js";
/** @import { RestoredView } from "./types" */

function toAddress() {
  if (!app.camera) return;
  history.replaceState(null, "", toHash({ ...app.camera.state(), time: value("when"), ...shown() }));
}

/** @param {RestoredView} view */
export function restore({ eye, target, up, fov, size, time = NaN, look, alone, hidden, edits, range, palette }) {
  if (!app.camera || !app.welcome) return;
  app.camera.restore({ eye, target, up, fov: size ? trainingFov(fov, size, app.welcome.size) : fov });
  if (time >= 0 && time <= 1) setTime(time);
  if (look && [...$("look").options].some((o) => o.value === look)) $("look").value = look;
  setAlone(alone);
  setHidden(hidden);
  setRange(isRange(range) ? range : null);
  $("edits-on").checked = edits !== false;
  emit("restored", palette);
  requestView(false);
}

export function fromAddress() {
  const view = fromHash(location.hash);
  if (view) restore(view);
}

on("rested", toAddress);
