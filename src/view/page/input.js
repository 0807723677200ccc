// Mouse, touch and keyboard input on the picture.
import { $, canvas, focused, focusedInput, typing } from "./dom.js";
import { flip } from "./compare.js";
import { asking } from "./help.js";
import { reveal } from "./panels.js";
import { requestView } from "./picture.js";
import { centreOn, clear, click } from "./selection.js";
import { save } from "./share.js";
import { change } from "./socket.js";
import { app } from "./state.js";
import { nudge, play } from "./time.js";
/** @import { Vec2 } from "./types" */

/** @type {{ moved: number, button: number, shift: boolean, ctrl: boolean } | null} */
let drag = null;
/** The last click, which may begin a double click. @type {{ at: number, place: Vec2, before: boolean, done: Promise<void> | null }} */
let clicked = { at: 0, place: [0, 0], before: false, done: null };
/** @type {Map<number, Vec2>} */
const fingers = new Map();
canvas.addEventListener("pointerdown", (e) => {
  canvas.focus();
  canvas.setPointerCapture(e.pointerId);
  fingers.set(e.pointerId, [e.clientX, e.clientY]);
  drag = { moved: 0, button: e.button, shift: e.shiftKey, ctrl: e.ctrlKey };
});
canvas.addEventListener("pointermove", (e) => {
  const from = fingers.get(e.pointerId), camera = app.camera;
  if (!drag || !from || !camera) return;
  const before = [...fingers.values()];
  fingers.set(e.pointerId, [e.clientX, e.clientY]);
  const [dx, dy] = [e.clientX - from[0], e.clientY - from[1]];
  drag.moved += Math.abs(dx) + Math.abs(dy);
  if (drag.moved < 4) return;
  const width = Math.min(canvas.clientWidth, canvas.clientHeight);
  if (fingers.size === 2) {
    const after = [...fingers.values()];
    /** @param {Vec2[]} places */
    const apart = ([a, b]) => Math.hypot(a[0] - b[0], a[1] - b[1]);
    camera.dolly(apart(before) / Math.max(apart(after), 1));
    camera.pan(dx / width / 2, dy / width / 2);
  } else if (drag.button === 2 || drag.ctrl) camera.dolly(Math.exp((2 * dy) / width));
  else if (drag.button === 1 || drag.shift) camera.pan(dx / width, dy / width);
  else camera.orbit(dx / width, dy / width);
  requestView(true);
});
/** A click selects at once; a second one soon after it at the same place is ignored here, see dblclick. @param {PointerEvent} e */
function tap(e) {
  const near = Math.hypot(e.clientX - clicked.place[0], e.clientY - clicked.place[1]) < 6;
  if (near && e.timeStamp - clicked.at < 400) return;
  clicked = { at: e.timeStamp, place: [e.clientX, e.clientY], before: Boolean(app.picked), done: click(e) };
}
canvas.addEventListener("dblclick", async (e) => {
  await clicked.done;
  if (!clicked.before) clear();
  centreOn(e);
});
/** @param {PointerEvent} e */
const release = (e) => {
  fingers.delete(e.pointerId);
  if (drag && e.type === "pointerup" && drag.moved < 4 && drag.button === 0) tap(e);
  else requestView(false);
  if (!fingers.size) drag = null;
};
canvas.addEventListener("pointerup", release);
canvas.addEventListener("pointercancel", release);
canvas.addEventListener("contextmenu", (e) => e.preventDefault());
canvas.addEventListener("wheel", (e) => {
  e.preventDefault();
  app.camera?.dolly(Math.exp(Math.sign(e.deltaY) * Math.min(Math.abs(e.deltaY), 200) / 800));
  requestView(true);
}, { passive: false });

document.addEventListener("keydown", (e) => {
  if (asking()) return;
  if ((e.ctrlKey || e.metaKey) && e.key.toLowerCase() === "z" && !typing()) {
    e.preventDefault();
    // undoes or redoes segments or edits, whichever changed last
    change({ kind: "last", undo: !e.shiftKey });
    return;
  }
  if (e.key === "Escape") return clear();
  if (typing()) return;
  const camera = app.camera, at = focused();
  if (e.ctrlKey || e.metaKey || !camera) return;
  const turn = 0.03;
  /** @type {Record<string, () => void>} */
  const keys = {
    ArrowLeft: () => camera.orbit(-turn, 0), ArrowRight: () => camera.orbit(turn, 0),
    ArrowUp: () => camera.orbit(0, -turn), ArrowDown: () => camera.orbit(0, turn),
    "+": () => camera.dolly(0.9), "-": () => camera.dolly(1 / 0.9),
    q: () => camera.roll(-0.05), e: () => camera.roll(0.05), r: () => camera.reset(),
  };
  if (focusedInput() === "range" && e.key.startsWith("Arrow")) return;
  if (keys[e.key]) {
    e.preventDefault();
    keys[e.key]();
    requestView(true);
    return;
  }
  // on a button, checkbox or colour input, Space keeps its own meaning
  if (e.key === " " && !at?.matches("button, summary, [type=checkbox], [type=color]")) { e.preventDefault(); play(); }
  if (e.key === ",") nudge(-1);
  if (e.key === ".") nudge(1);
  if (e.key === "s") save();
  if (e.key === "f") flip();
  if (e.key === "Enter" && app.picked && at === canvas) {
    reveal($("name"));
    $("name").focus();
  }
});
