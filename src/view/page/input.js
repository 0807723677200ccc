// Mouse, touch and keyboard input on the picture.
import { $, app, canvas, typing } from "./state.js";
import { change } from "./socket.js";
import { look } from "./picture.js";
import { nudge, play } from "./time.js";
import { centreOn, clear, click } from "./selection.js";
import { flip } from "./compare.js";
import { save } from "./take.js";
import { asking } from "./help.js";
import { reveal } from "./parts.js";

let drag = null;
let clicked = { at: 0, place: [0, 0], before: false, done: null }; // the last click; may begin a double click
const fingers = new Map();
canvas.addEventListener("pointerdown", (e) => {
  canvas.focus();
  canvas.setPointerCapture(e.pointerId);
  fingers.set(e.pointerId, [e.clientX, e.clientY]);
  drag = { moved: 0, button: e.button, shift: e.shiftKey, ctrl: e.ctrlKey, alt: e.altKey };
});
canvas.addEventListener("pointermove", (e) => {
  if (!drag || !fingers.has(e.pointerId)) return;
  const before = [...fingers.values()];
  const [x, y] = fingers.get(e.pointerId);
  fingers.set(e.pointerId, [e.clientX, e.clientY]);
  const [dx, dy] = [e.clientX - x, e.clientY - y];
  drag.moved += Math.abs(dx) + Math.abs(dy);
  if (drag.moved < 4) return;
  const width = Math.min(canvas.clientWidth, canvas.clientHeight);
  if (fingers.size === 2) {
    const after = [...fingers.values()];
    const apart = ([a, b]) => Math.hypot(a[0] - b[0], a[1] - b[1]);
    app.camera.dolly(apart(before) / Math.max(apart(after), 1));
    app.camera.pan(dx / width / 2, dy / width / 2);
  } else if (drag.button === 2 || drag.ctrl) app.camera.dolly(Math.exp((2 * dy) / width));
  else if (drag.button === 1 || drag.shift) app.camera.pan(dx / width, dy / width);
  else app.camera.orbit(dx / width, dy / width);
  look(true);
});
// a click selects at once; a second click soon after it at the same place is ignored here, see dblclick
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
const release = (e) => {
  fingers.delete(e.pointerId);
  if (drag && e.type === "pointerup" && drag.moved < 4 && drag.button === 0) tap(e);
  else look(false);
  if (!fingers.size) drag = null;
};
canvas.addEventListener("pointerup", release);
canvas.addEventListener("pointercancel", release);
canvas.addEventListener("contextmenu", (e) => e.preventDefault());
canvas.addEventListener("wheel", (e) => {
  e.preventDefault();
  app.camera.dolly(Math.exp(Math.sign(e.deltaY) * Math.min(Math.abs(e.deltaY), 200) / 800));
  look(true);
}, { passive: false });

document.addEventListener("keydown", (e) => {
  if (asking()) return;
  if ((e.ctrlKey || e.metaKey) && e.key.toLowerCase() === "z" && !typing()) {
    e.preventDefault();
    // undoes or redoes segments or edits, whichever changed last
    return change({ kind: "last", undo: !e.shiftKey });
  }
  if (e.key === "Escape") return clear();
  if (typing()) return;
  if (e.ctrlKey || e.metaKey || !app.camera) return;
  const turn = 0.03;
  const keys = {
    ArrowLeft: () => app.camera.orbit(-turn, 0), ArrowRight: () => app.camera.orbit(turn, 0),
    ArrowUp: () => app.camera.orbit(0, -turn), ArrowDown: () => app.camera.orbit(0, turn),
    "+": () => app.camera.dolly(0.9), "-": () => app.camera.dolly(1 / 0.9),
    q: () => app.camera.roll(-0.05), e: () => app.camera.roll(0.05), r: () => app.camera.reset(),
  };
  if (document.activeElement?.type === "range" && e.key.startsWith("Arrow")) return;
  if (keys[e.key]) {
    e.preventDefault();
    keys[e.key]();
    return look(true);
  }
  // on a button, checkbox or colour input, Space keeps its own meaning
  if (e.key === " " && !document.activeElement?.matches("button, summary, [type=checkbox], [type=color]")) { e.preventDefault(); play(); }
  if (e.key === ",") nudge(-1);
  if (e.key === ".") nudge(1);
  if (e.key === "s") save();
  if (e.key === "f") flip();
  if (e.key === "Enter" && app.picked && document.activeElement === canvas) {
    reveal($("name"));
    $("name").focus();
  }
});
