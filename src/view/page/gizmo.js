// Handles on the picture that move, turn and scale the checked segments: arrows, rings, and a square in the middle.
// While a handle is dragged, its edit is only previewed; on release it is made, as one step.
import { $, element, say, value } from "./dom.js";
import { add, dot, mul, sub, unit } from "./camera.js";
import { requestView, restingView, size } from "./picture.js";
import { along, projection, ring, turned } from "./projection.js";
import { ask, change } from "./socket.js";
import { app, on, setPreview } from "./state.js";
import { lengthText } from "./units.js";
/** @import { Operation } from "./protocol" */
/** @import { Vec2, Vec3 } from "./types" */

/**
 * A visible mark, and a wider line that receives the pointer.
 * @typedef {object} Handle
 * @property {"move" | "turn" | "scale"} kind
 * @property {Vec3} axis of no meaning for the scale
 * @property {string} label
 * @property {SVGGElement} group
 * @property {SVGElement} grip
 * @property {SVGElement} mark
 */
/**
 * A handle that is dragged, or moved by keys.
 * @typedef {object} Drag
 * @property {Handle} handle
 * @property {boolean} keys whether by keys
 * @property {string[]} segments
 * @property {number} amount scene units, degrees, or the logarithm of a factor
 * @property {Vec3} at the centre when it was grabbed
 * @property {number | null} start where along the axis it was grabbed
 * @property {Vec2 | null} pixel where it was grabbed; for a turn, the last place of the pointer
 * @property {number} total degrees before they snap
 */

/** @type {Record<"x" | "y" | "z", Vec3>} */
const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
const REACH = 90; // pixels from the centre to the end of an arrow
const RADIUS = 0.75; // of the rings, in lengths of an arrow
const svg = $("gizmo");
/** @type {Vec3 | null} */
let centre = null; // of the checked segments, in scene units
let asked = ""; // what the centre was last requested for
/** @type {Drag | null} */
let drag = null;

/** The projection of the picture; null before the camera is known. */
function lens() {
  const view = restingView();
  return view && app.camera ? projection(view.eye, app.camera.axes(), view.fov, size()) : null;
}

/** @param {Drag} drag @returns {Operation} */
function operation({ handle: { kind, axis }, amount, segments }) {
  // a single segment turns about its own centre at every time; several turn about their common centre
  const about = segments.length > 1 ? centre : null;
  if (kind === "move") return { translate: { by: mul(axis, amount) } };
  if (kind === "turn") return { rotate: { axis, degrees: amount, about } };
  return { scale: { factor: Math.exp(amount), about } };
}
/** @param {Drag} drag */
const amountText = ({ handle: { kind }, amount }) =>
  kind === "move" ? lengthText(amount) : kind === "turn" ? `${amount.toFixed(0)}°` : `× ${Math.exp(amount).toFixed(2)}`;

/** @param {Drag} drag */
function preview(drag) {
  setPreview(drag.amount ? [{ segments: drag.segments, operation: operation(drag) }] : []);
  say(`${drag.handle.label}: ${amountText(drag)} (Esc cancels)`);
  requestView(true);
  draw();
}

/** @param {boolean} save */
async function finish(save) {
  if (!drag) return;
  const done = drag;
  drag = null;
  say("");
  if (save && done.amount) await change({ kind: "edit", segments: done.segments, operation: operation(done) });
  if (!drag) setPreview(null);
  requestView(false);
  draw();
}

/** @param {Handle} handle @param {Vec3} at @param {boolean} keys @returns {Drag} */
const begin = (handle, at, keys) => ({ handle, keys, segments: [...app.checked], amount: 0, at, start: null, pixel: null, total: 0 });

/**
 * Updates the drag from the point where the handle was grabbed to the pointer.
 * @param {Drag} drag
 * @param {Vec2} pixel
 * @param {boolean} snap
 */
function pull(drag, pixel, snap) {
  const camera = lens();
  if (!camera) return;
  const { kind, axis } = drag.handle;
  drag.pixel ??= pixel;
  if (kind === "move") {
    const now = along(drag.at, axis, pixel, camera);
    drag.start ??= now;
    drag.amount = now - drag.start;
  } else if (kind === "scale") {
    drag.amount = (pixel[0] - drag.pixel[0] + drag.pixel[1] - pixel[1]) / 120;
  } else {
    drag.total += turned(drag.at, axis, [drag.pixel, pixel], camera, RADIUS * REACH);
    drag.pixel = pixel;
    drag.amount = snap ? 15 * Math.round(drag.total / 15) : drag.total;
  }
  preview(drag);
}

/** @param {PointerEvent} e @returns {Vec2} */
const pointer = (e) => {
  const box = $("stage").getBoundingClientRect();
  return [e.clientX - box.left, e.clientY - box.top];
};

/**
 * @param {Handle["kind"]} kind
 * @param {"x" | "y" | "z" | "all"} name
 * @param {string} label
 * @param {number | null} step for one key press, degrees or the logarithm of a factor; a move has five pixels
 */
function handle(kind, name, label, step) {
  const aria = { role: "slider", "aria-label": label, "aria-valuenow": 0, "aria-valuetext": "0" };
  const group = element("g", { class: `handle ${name}`, tabindex: 0, ...aria });
  const line = kind === "scale" ? "rect" : kind === "turn" ? "polyline" : "path";
  /** @type {Record<string, number>} */
  const size = kind === "scale" ? { width: 14, height: 14 } : {};
  const grip = element(line, { class: "grip", ...size }), mark = element(line, { class: "mark", ...size });
  group.append(grip, mark, element("title", {}, label));
  /** @type {Handle} */
  const own = { kind, axis: name === "all" ? [0, 0, 0] : AXES[name], label, group, grip, mark };
  /** The drag of this handle by the pointer or by keys, if there is one. @param {boolean} keys */
  const ownDrag = (keys) => (drag?.handle === own && drag.keys === keys ? drag : null);
  group.addEventListener("pointerdown", (e) => {
    if (e.button !== 0 || !centre) return;
    e.stopPropagation();
    group.setPointerCapture(e.pointerId);
    drag = begin(own, centre, false);
    pull(drag, pointer(e), false);
  });
  group.addEventListener("pointermove", (e) => {
    const now = ownDrag(false);
    if (now) pull(now, pointer(e), e.shiftKey);
  });
  group.addEventListener("pointerup", () => ownDrag(false) && finish(true));
  group.addEventListener("pointercancel", () => drag?.handle === own && finish(false));
  group.addEventListener("keydown", (e) => {
    const by = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[e.key];
    if (by && centre) {
      if (drag?.handle !== own) drag = begin(own, centre, true);
      drag.amount += by * (step ?? Math.max((lens()?.pixel(drag.at) ?? 0) * 5, 1e-9));
      preview(drag);
    } else if (e.key !== "Enter" || !drag) return;
    else finish(true);
    e.preventDefault();
    e.stopPropagation();
  });
  group.addEventListener("blur", () => ownDrag(true) && finish(true));
  return own;
}

const NAMES = /** @type {const} */ (["x", "y", "z"]);
const handles = [
  ...NAMES.map((axis) => handle("turn", axis, `Turn about ${axis}`, 5)),
  ...NAMES.map((axis) => handle("move", axis, `Move along ${axis}`, null)),
  handle("scale", "all", "Scale", 0.05),
];
svg.append(...handles.map((h) => h.group));

// in the capture phase, before any other listener
document.addEventListener("keydown", (e) => {
  if (e.key !== "Escape" || !drag) return;
  e.stopImmediatePropagation();
  finish(false);
}, true);

function draw() {
  const wanted = app.checked.size && !app.playing && $("gizmo-on").checked && $("edits-on").checked && !app.welcome?.read_only;
  const camera = wanted && lens();
  const moved = centre && (drag?.handle.kind === "move" ? add(drag.at, mul(drag.handle.axis, drag.amount)) : centre);
  const middle = camera && moved ? camera.project(moved) : null;
  svg.toggleAttribute("hidden", !middle);
  if (!camera || !moved || !middle) return;
  const [width, height] = size();
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const reach = REACH * camera.pixel(moved);
  const sight = unit(sub(moved, camera.eye));
  for (const own of handles) {
    const { kind, axis, group, grip, mark, label } = own;
    const active = drag?.handle === own ? drag : null;
    group.classList.toggle("active", Boolean(active));
    group.setAttribute("aria-valuenow", String(active ? active.amount : 0));
    group.setAttribute("aria-valuetext", active ? amountText(active) : label);
    if (kind === "scale") {
      for (const part of [grip, mark]) { part.setAttribute("x", String(middle[0] - 7)); part.setAttribute("y", String(middle[1] - 7)); }
    } else if (kind === "move") {
      const end = camera.project(add(moved, mul(axis, reach)));
      // an arrow that points at the eye cannot be dragged
      group.toggleAttribute("hidden", !end || Math.abs(dot(axis, sight)) > 0.97);
      if (!end) continue;
      const [shaft, head] = arrow(middle, end);
      grip.setAttribute("d", shaft);
      mark.setAttribute("d", `${shaft} ${head}`);
    } else {
      const text = ring(moved, axis, RADIUS * reach, camera).map((p) => p.map((v) => v.toFixed(1)).join(",")).join(" ");
      for (const part of [grip, mark]) part.setAttribute("points", text);
    }
  }
}

/** Paths of an arrow's shaft and head. @param {Vec2} from @param {Vec2} to */
function arrow(from, to) {
  const d = [to[0] - from[0], to[1] - from[1]], n = Math.hypot(...d) || 1;
  const [ux, uy] = [d[0] / n, d[1] / n];
  /** @param {number} s */
  const tip = (s) => `L ${to[0] - 11 * ux + s * 5 * uy} ${to[1] - 11 * uy - s * 5 * ux}`;
  return [`M ${from[0] + 12 * ux} ${from[1] + 12 * uy} L ${to[0]} ${to[1]}`, `${tip(1)} ${tip(-1)} L ${to[0]} ${to[1]}`];
}

// requests the centre of the checked segments when it may have changed
async function update() {
  if (drag || !app.welcome || app.welcome.read_only) return;
  const wanted = { segments: [...app.checked], time: value("when") };
  const key = JSON.stringify([wanted, app.doc.revision]);
  if (key === asked) return draw();
  asked = key;
  if (!wanted.segments.length) { centre = null; return draw(); }
  const found = await ask({ type: "centre", ...wanted }).catch(() => null);
  if (asked !== key || drag) return;
  centre = found && found.at;
  draw();
}

on("document", update);
on("checked", update);
on("rested", update);
on("frame", draw);
on("welcome", () => { asked = ""; });
$("gizmo-on").onchange = draw;
new ResizeObserver(draw).observe($("stage"));
