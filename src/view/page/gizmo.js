// Handles on the picture that move, turn and scale the checked segments: arrows, rings, and a square in the middle.
// While a handle is dragged, its edit is only previewed; on release it is made, as one step.
import { $, app, element, on, say, value } from "./state.js";
import { add, cross, dot, mul, sub, unit } from "./camera.js";
import { ask, change } from "./socket.js";
import { look, size, view } from "./picture.js";
import { lengthText } from "./units.js";

const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
const REACH = 90; // pixels from the centre to the end of an arrow
const svg = $("gizmo");
let centre = null; // of the checked segments, in scene units
let asked = ""; // what the centre was last requested for
let drag = null; // the handle that is being dragged or moved by keys

// the camera of the picture: projections of points, and rays of pixels
function lens() {
  const { eye, fov } = view(false);
  const { forward, right, up } = app.camera.axes();
  const [width, height] = size();
  const focal = width / 2 / Math.tan(fov / 2);
  return {
    eye,
    project(p) {
      const v = sub(p, eye), z = dot(v, forward);
      return z > 1e-9 ? [width / 2 + (focal * dot(v, right)) / z, height / 2 - (focal * dot(v, up)) / z] : null;
    },
    ray: ([x, y]) => unit(add(forward, add(mul(right, (x - width / 2) / focal), mul(up, (height / 2 - y) / focal)))),
    // size of a pixel at a point, in scene units
    pixel: (p) => dot(sub(p, eye), forward) / focal,
  };
}

// position along the line through p at which it is closest to the pixel's ray
function along(p, axis, pixel, { eye, ray }) {
  const d = ray(pixel), w = sub(p, eye), b = dot(axis, d);
  return (b * dot(d, w) - dot(axis, w)) / Math.max(1 - b * b, 1e-6);
}

// intersection of the pixel's ray with the plane through p
function across(p, normal, pixel, { eye, ray }) {
  const d = ray(pixel);
  return add(eye, mul(d, dot(sub(p, eye), normal) / dot(d, normal)));
}

const operation = ({ kind, axis, amount, segments }) => {
  // a single segment turns about its own centre at every time; several turn about their common centre
  const about = segments.length > 1 ? centre : null;
  if (kind === "move") return { translate: { by: mul(AXES[axis], amount) } };
  if (kind === "turn") return { rotate: { axis: AXES[axis], degrees: amount, about } };
  return { scale: { factor: Math.exp(amount), about } };
};
const shown = ({ kind, amount }) =>
  kind === "move" ? lengthText(amount) : kind === "turn" ? `${amount.toFixed(0)}°` : `× ${Math.exp(amount).toFixed(2)}`;

function preview() {
  const { segments } = drag;
  app.preview = { base: app.doc.revision, edits: drag.amount ? [{ segments, operation: operation(drag) }] : [] };
  say(`${drag.label}: ${shown(drag)} (Esc cancels)`);
  look(true);
  draw();
}

async function finish(save) {
  if (!drag) return;
  const done = drag;
  drag = null;
  say("");
  if (save && done.amount) await change({ kind: "edit", segments: done.segments, operation: operation(done) });
  if (!drag) app.preview = null;
  look(false);
  draw();
}

const begin = (handle) => ({ ...handle, segments: [...app.checked], amount: 0, at: centre });

// updates the drag from the point where the handle was grabbed to the pointer
function pull(pixel, snap) {
  const camera = lens();
  const axis = AXES[drag.axis];
  if (drag.kind === "move") {
    const now = along(drag.at, axis, pixel, camera);
    drag.from ??= now;
    drag.amount = now - drag.from;
  } else if (drag.kind === "scale") {
    drag.from ??= pixel;
    drag.amount = (pixel[0] - drag.from[0] + drag.from[1] - pixel[1]) / 120;
  } else {
    drag.total = (drag.total ?? 0) + turned(axis, pixel, camera);
    drag.from = pixel;
    drag.amount = snap ? 15 * Math.round(drag.total / 15) : drag.total;
  }
  preview();
}

// degrees turned since the last position of the pointer
function turned(axis, pixel, camera) {
  if (!drag.from) return 0;
  const sight = unit(sub(drag.at, camera.eye));
  if (Math.abs(dot(axis, sight)) > 0.25) {
    const [a, b] = [drag.from, pixel].map((p) => sub(across(drag.at, axis, p, camera), drag.at));
    return (Math.atan2(dot(cross(a, b), axis), dot(a, b)) * 180) / Math.PI;
  }
  // seen edge-on: movement across the axis on the screen, a ring's radius per radian
  const [from, to] = [camera.project(drag.at), camera.project(add(drag.at, mul(axis, camera.pixel(drag.at))))];
  const [ux, uy] = [to[0] - from[0], to[1] - from[1]], norm = Math.hypot(ux, uy) || 1;
  return ((pixel[1] - drag.from[1]) * ux - (pixel[0] - drag.from[0]) * uy) / norm / (0.75 * REACH) * (180 / Math.PI);
}

const place = (e) => {
  const box = $("stage").getBoundingClientRect();
  return [e.clientX - box.left, e.clientY - box.top];
};

// makes a handle: a visible mark, and a wider line that receives the pointer
function handle(kind, axis, label, step) {
  const group = element("g", { class: `handle ${axis ?? "all"}`, tabindex: 0, role: "slider", "aria-label": label, "aria-valuenow": 0, "aria-valuetext": "0" });
  const line = kind === "scale" ? "rect" : kind === "turn" ? "polyline" : "path";
  const size = kind === "scale" ? { width: 14, height: 14 } : {};
  const [grip, mark] = ["grip", "mark"].map((name) => element(line, { class: name, ...size }));
  group.append(grip, mark);
  const title = element("title", {});
  title.textContent = label;
  group.append(title);
  const own = { kind, axis, label, group, grip, mark };
  group.addEventListener("pointerdown", (e) => {
    if (e.button !== 0 || !centre) return;
    e.stopPropagation();
    group.setPointerCapture(e.pointerId);
    drag = begin(own);
    pull(place(e), false);
  });
  group.addEventListener("pointermove", (e) => drag?.group === group && !drag.keys && pull(place(e), e.shiftKey));
  group.addEventListener("pointerup", () => drag?.group === group && !drag.keys && finish(true));
  group.addEventListener("pointercancel", () => drag?.group === group && finish(false));
  group.addEventListener("keydown", (e) => {
    const by = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[e.key];
    if (by && centre) {
      if (drag?.group !== group) drag = { ...begin(own), keys: true };
      drag.amount += by * (step ?? Math.max(lens().pixel(drag.at) * 5, 1e-9));
      preview();
    } else if (e.key !== "Enter" || !drag) return;
    else finish(true);
    e.preventDefault();
    e.stopPropagation();
  });
  group.addEventListener("blur", () => drag?.group === group && drag.keys && finish(true));
  return own;
}

const handles = [
  ...["x", "y", "z"].map((axis) => handle("turn", axis, `Turn about ${axis}`, 5)),
  ...["x", "y", "z"].map((axis) => handle("move", axis, `Move along ${axis}`, null)),
  handle("scale", null, "Scale", 0.05),
];
svg.append(...handles.map((h) => h.group));

// in the capture phase, before any other listener
document.addEventListener("keydown", (e) => {
  if (e.key !== "Escape" || !drag) return;
  e.stopImmediatePropagation();
  finish(false);
}, true);

function draw() {
  const there = centre && app.camera && app.checked.size && !app.playing && $("gizmo-on").checked && $("edits-on").checked && !app.welcome?.read_only;
  svg.toggleAttribute("hidden", !there);
  if (!there) return;
  const camera = lens();
  const moved = drag?.kind === "move" ? add(drag.at, mul(AXES[drag.axis], drag.amount)) : centre;
  const middle = camera.project(moved);
  svg.toggleAttribute("hidden", !middle);
  if (!middle) return;
  const [width, height] = size();
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const unitOf = REACH * camera.pixel(moved);
  const sight = unit(sub(moved, camera.eye));
  for (const { kind, axis, group, grip, mark, label } of handles) {
    const active = drag?.group === group;
    group.classList.toggle("active", active);
    group.setAttribute("aria-valuenow", active ? drag.amount : 0);
    group.setAttribute("aria-valuetext", active ? shown(drag) : label);
    if (kind === "scale") {
      for (const part of [grip, mark]) { part.setAttribute("x", middle[0] - 7); part.setAttribute("y", middle[1] - 7); }
      continue;
    }
    const a = AXES[axis];
    if (kind === "move") {
      const end = camera.project(add(moved, mul(a, unitOf)));
      // an arrow that points at the eye cannot be dragged
      group.toggleAttribute("hidden", !end || Math.abs(dot(a, sight)) > 0.97);
      if (!end) continue;
      const d = [end[0] - middle[0], end[1] - middle[1]], n = Math.hypot(...d) || 1;
      const [ux, uy] = [d[0] / n, d[1] / n];
      const tip = (s) => `L ${end[0] - 11 * ux + s * 5 * uy} ${end[1] - 11 * uy - s * 5 * ux}`;
      const shaft = `M ${middle[0] + 12 * ux} ${middle[1] + 12 * uy} L ${end[0]} ${end[1]}`;
      grip.setAttribute("d", shaft);
      mark.setAttribute("d", `${shaft} ${tip(1)} ${tip(-1)} L ${end[0]} ${end[1]}`);
      continue;
    }
    const side = unit(cross(a, Math.abs(a[2]) > 0.9 ? AXES.x : AXES.z)), other = cross(a, side);
    const points = [];
    for (let k = 0; k <= 64; k++) {
      const t = (k * Math.PI) / 32;
      const out = add(mul(side, Math.cos(t)), mul(other, Math.sin(t)));
      // only the half that faces the eye is drawn
      if (dot(out, sight) > 0.05 && Math.abs(dot(a, sight)) < 0.97) { points.push(null); continue; }
      points.push(camera.project(add(moved, mul(out, 0.75 * unitOf))));
    }
    // starts after the hidden half, so that the visible part is one line
    const gap = points.lastIndexOf(null);
    const line = gap < 0 ? points : [...points.slice(gap + 1), ...points.slice(1, gap + 1)];
    const text = line.filter(Boolean).map((p) => p.map((v) => v.toFixed(1)).join(",")).join(" ");
    for (const part of [grip, mark]) part.setAttribute("points", text);
  }
}

// requests the centre of the checked segments when it may have changed
function update() {
  if (drag || !app.welcome || app.welcome.read_only) return;
  const of = { segments: [...app.checked], time: value("when") };
  const key = JSON.stringify([of, app.doc.revision]);
  if (key === asked) return draw();
  asked = key;
  if (!of.segments.length) { centre = null; return draw(); }
  ask({ type: "centre", ...of }).then(({ at }) => at, () => null).then((at) => {
    if (asked !== key || drag) return;
    centre = at;
    draw();
  });
}

on("document", update);
on("checked", update);
on("rested", update);
on("frame", draw);
on("welcome", () => { asked = ""; });
$("gizmo-on").onchange = draw;
new ResizeObserver(draw).observe($("stage"));
