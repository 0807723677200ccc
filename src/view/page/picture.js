// The picture: sends the requested view to the server, and draws the frames that arrive.
import { $, app, canvas, tell, value } from "./state.js";
import { answered, hear, send } from "./socket.js";

const HEADER = 32;
// kinds of frames: the picture, a requested file, the dataset's image; any other is drawn beside the picture
const [PICTURE, STILL, IMAGE] = [0, 2, 3];
const context = canvas.getContext("2d", { willReadFrequently: true });
let lastView = "";
let frames = [];

// the picture fills the stage
export function size() {
  const box = $("stage").getBoundingClientRect();
  const columns = $("stage").classList.contains("side") ? 2 : 1;
  return [Math.floor(box.width / columns), box.height].map((n) => Math.min(4096, Math.max(16, Math.round(n))));
}

// ratio of the tangents of half the field of view, of a picture of this size to a training image
const wider = ([width, height]) => Math.max(1, width / height / (app.welcome.size[0] / app.welcome.size[1]));

// converts the field of view of a picture of this size to that of a training image
export const narrowed = (fov, of) => 2 * Math.atan(Math.tan(fov / 2) / wider(of));

// a field of view wide enough that the picture shows all that a training image would, whatever its aspect ratio
function lens() {
  return 2 * Math.atan(Math.tan(app.camera.fov / 2) * wider(size()));
}

export function view(moving) {
  return {
    ...app.camera.state(), fov: lens(), size: size(), time: value("when"), look: $("look").value,
    palette: $("palette").value || null,
    alone: app.alone, hidden: [...app.hidden], edits: $("edits-on").checked, preview: app.preview, range: app.range, moving,
    compare: app.compare,
  };
}

// marks the picture as outdated; a new one will arrive
export function stale() {
  canvas.dataset.lossless = false;
}

let resting;
// requests the current view; returns whether it differs from the last request
export function look(moving) {
  if (!app.camera || !app.welcome) return false;
  const wanted = view(moving);
  const text = JSON.stringify(wanted);
  if (text === lastView) return false;
  lastView = text;
  stale();
  send({ type: "view", ...wanted });
  clearTimeout(resting);
  resting = setTimeout(moving ? () => look(false) : () => tell("rested"), moving ? 200 : 300);
  return true;
}

// requests the view again, as a new connection does not know the last request
export function again() {
  lastView = "";
  look(false);
}

async function show(data) {
  const head = new DataView(data);
  const frame = head.getUint32(4, true);
  const [width, height] = [head.getUint16(16, true), head.getUint16(18, true)];
  const png = head.getUint8(1) === 1;
  const bytes = new Blob([new Uint8Array(data, HEADER)], { type: png ? "image/png" : "image/jpeg" });
  const kind = head.getUint8(2);
  if (kind === STILL) {
    answered(frame);
    return tell("still", bytes);
  }
  const picture = await createImageBitmap(bytes);
  if (kind !== PICTURE) return tell("other", { bitmap: picture, number: frame, isImage: kind === IMAGE });
  send({ type: "ack", frame });
  const [w, h] = size();
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  context.drawImage(picture, 0, 0, w, h);
  picture.close();
  canvas.dataset.frame = frame;
  canvas.dataset.lossless = png;
  canvas.dataset.revision = head.getUint32(8, true);
  canvas.dataset.time = head.getFloat32(20, true).toFixed(4);
  frames = [...frames.filter((t) => t > performance.now() - 1000), performance.now()];
  const [render, encode] = [head.getFloat32(24, true), head.getFloat32(28, true)].map((v) => v.toFixed(0));
  $("figures").textContent = `${width}×${height}${png ? ", lossless" : ""}, ${render} + ${encode} ms` + (app.playing ? `, ${frames.length} frames/s` : "");
  tell("frame");
}

hear("frame", show);
$("edits-on").onchange = () => look(false);
new ResizeObserver(() => look(false)).observe($("stage"));
