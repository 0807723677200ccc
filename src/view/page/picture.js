// The picture: sends the requested view to the viewer, and draws the frames that arrive.
import { $, canvas, context2d, value } from "./dom.js";
import { pictureFov } from "./camera.js";
import { KINDS, header, picture } from "./frame.js";
import { answered, hear, send } from "./socket.js";
import { app, emit } from "./state.js";
/** @import { Camera, RequestOf, Vec2, Welcome } from "./types" */

const context = context2d(canvas, { willReadFrequently: true });
let lastView = "";
/** @type {number[]} */
let frames = []; // when those of the last second were drawn

/** Width and height of the picture, which fills the stage. @returns {Vec2} */
export function size() {
  const box = $("stage").getBoundingClientRect();
  const columns = $("stage").classList.contains("side") ? 2 : 1;
  /** @param {number} n */
  const side = (n) => Math.min(4096, Math.max(16, Math.round(n)));
  return [side(Math.floor(box.width / columns)), side(box.height)];
}

/** What the picture shows, whatever the camera and the time. */
export const shown = () => ({
  look: $("look").value, palette: $("palette").value || null, alone: [...app.alone], hidden: [...app.hidden],
  edits: $("edits-on").checked, range: app.range,
});

/** @param {Camera} camera @param {Welcome} welcome @param {boolean} moving @returns {RequestOf<"view">} */
function view(camera, welcome, moving) {
  return {
    type: "view", ...camera.state(), fov: pictureFov(camera.fov, size(), welcome.size), size: size(), time: value("when"),
    ...shown(), preview: app.preview, moving, compare: app.compare,
  };
}

/** The view that is shown at rest; null before the camera is known. */
export const restingView = () => (app.camera && app.welcome ? view(app.camera, app.welcome, false) : null);

/** Marks the picture as outdated; a new one will arrive. */
export function stale() {
  canvas.dataset.lossless = "false";
}

/** @type {number | undefined} */
let resting;
/**
 * Requests the current view; returns whether it differs from the last request.
 * @param {boolean} moving whether more changes are to come at once
 */
export function requestView(moving) {
  if (!app.camera || !app.welcome) return false;
  const wanted = view(app.camera, app.welcome, moving);
  const text = JSON.stringify(wanted);
  if (text === lastView) return false;
  lastView = text;
  stale();
  send(wanted);
  clearTimeout(resting);
  resting = setTimeout(moving ? () => requestView(false) : () => emit("rested", undefined), moving ? 200 : 300);
  return true;
}

/** Requests the view again, as a new connection does not know the last request. */
export function requestViewAgain() {
  lastView = "";
  requestView(false);
}

/** @param {ArrayBuffer} data */
async function show(data) {
  const { png, kind, number, revision, width, height, time, ms } = header(data);
  const bytes = picture(data, png);
  if (kind === KINDS.still) {
    answered(number);
    return emit("still", bytes);
  }
  const bitmap = await createImageBitmap(bytes);
  if (kind !== KINDS.picture) return emit("other", { bitmap, number, isImage: kind === KINDS.image });
  send({ type: "ack", frame: number });
  const [w, h] = size();
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  context.drawImage(bitmap, 0, 0, w, h);
  bitmap.close();
  Object.assign(canvas.dataset, { frame: number, lossless: png, revision, time: time.toFixed(4) });
  frames = [...frames.filter((t) => t > performance.now() - 1000), performance.now()];
  const [render, encode] = ms.map((v) => v.toFixed(0));
  const rate = app.playing ? `, ${frames.length} frames/s` : "";
  $("figures").textContent = `${width}×${height}${png ? ", lossless" : ""}, ${render} + ${encode} ms${rate}`;
  emit("frame", undefined);
}

hear("frame", show);
$("edits-on").onchange = () => requestView(false);
new ResizeObserver(() => requestView(false)).observe($("stage"));
