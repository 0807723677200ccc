// The page: says what is to be seen, shows the frames that come, and asks for changes.
import { Camera } from "./camera.js";

const $ = (id) => document.getElementById(id);
const canvas = $("picture");
const context = canvas.getContext("2d", { willReadFrequently: true });
const HEADER = 32;

let socket, welcome, camera;
let doc = { revision: 0, segments: [], edits: [], segment_steps: [null, null], edit_steps: [false, false] };
const hidden = new Set(), checked = new Set();
let alone = [];
let playing = null;
let last = null; // the last lossless frame
let lastView = "";
let picked = null;
let number = 0;
let frames = [];
const waiting = new Map();

// --- talking ---

function connect() {
  socket = new WebSocket(`ws://${location.host}/ws`.replace("ws:", location.protocol === "https:" ? "wss:" : "ws:"));
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : show(data));
  socket.onclose = () => {
    say("The viewer does not answer; trying again …", true);
    setTimeout(connect, 1000);
  };
}

const send = (message) => socket?.readyState === 1 && socket.send(JSON.stringify(message));

// a request that is answered; resolves to the answer or rejects with its message
function ask(message) {
  const id = ++number;
  return new Promise((resolve, reject) => {
    waiting.set(id, { resolve, reject });
    send({ ...message, id });
  });
}

const change = (what) => ask({ type: "change", base: doc.revision, change: what }).catch((e) => say(e, true));

function say(text, wrong = false) {
  $("message").textContent = text;
  $("message").classList.toggle("wrong", wrong);
}

function hear(message) {
  switch (message.type) {
    case "welcome": return begin(message);
    case "document": return read(message);
    case "legend": $("legend").textContent = message.legend?.legend ?? ""; return;
    case "picked":
      waiting.get(message.id)?.resolve(message);
      waiting.delete(message.id);
      return selected(message);
    case "done":
      waiting.get(message.id)?.resolve(message);
      waiting.delete(message.id);
      return;
    case "error":
      if (message.id && waiting.has(message.id)) {
        waiting.get(message.id).reject(message.message);
        waiting.delete(message.id);
      } else say(message.message, true);
  }
}

function begin(message) {
  welcome = message;
  say(message.note ?? "");
  $("run").textContent = message.run;
  $("scene").textContent = `${message.gaussians.toLocaleString("en")} Gaussians` + (message.read_only ? ", read only" : "");
  document.title = `${message.run} – volseggs`;
  if (!camera) {
    camera = new Camera(message.centre, message.radius, message.fov);
    fromAddress();
  }
  if (!message.clicks) $("selected").textContent = "To select by clicks, make masks and train the affinity field first: volseggs segment coarse, masks, fine.";
  lastView = "";
  look(false);
}

// --- what is seen ---

// the picture fills the stage
function size() {
  const box = $("stage").getBoundingClientRect();
  return [box.width, box.height].map((n) => Math.min(4096, Math.max(16, Math.round(n))));
}

// the field of view, so wide that what a training image shows is in the picture, whatever its shape
function lens() {
  const [width, height] = size();
  const wider = Math.max(1, width / height / (welcome.size[0] / welcome.size[1]));
  return 2 * Math.atan(Math.tan(camera.fov / 2) * wider);
}

function view(moving) {
  return {
    ...camera.state(), fov: lens(), size: size(), time: Number($("when").value), look: $("look").value,
    alone, hidden: [...hidden], edits: $("edits-on").checked, moving,
  };
}

// the picture is not what is to be seen any more; a new one will come
function stale() {
  last = null;
  canvas.dataset.lossless = false;
}

let resting;
function look(moving) {
  if (!camera || !welcome) return;
  const wanted = view(moving);
  const text = JSON.stringify(wanted);
  if (text === lastView) return;
  lastView = text;
  stale();
  send({ type: "view", ...wanted });
  clearTimeout(resting);
  resting = setTimeout(moving ? () => look(false) : toAddress, moving ? 200 : 300);
}

async function show(data) {
  const head = new DataView(data);
  const frame = head.getUint32(4, true);
  const [width, height] = [head.getUint16(16, true), head.getUint16(18, true)];
  const png = head.getUint8(1) === 1;
  const bytes = new Blob([new Uint8Array(data, HEADER)], { type: png ? "image/png" : "image/jpeg" });
  const picture = await createImageBitmap(bytes);
  send({ type: "ack", frame });
  const [w, h] = size();
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  context.drawImage(picture, 0, 0, w, h);
  picture.close();
  last = png ? bytes : null;
  canvas.dataset.frame = frame;
  canvas.dataset.lossless = png;
  canvas.dataset.revision = head.getUint32(8, true);
  canvas.dataset.time = head.getFloat32(20, true).toFixed(4);
  frames = [...frames.filter((t) => t > performance.now() - 1000), performance.now()];
  const [render, encode] = [head.getFloat32(24, true), head.getFloat32(28, true)].map((v) => v.toFixed(0));
  $("figures").textContent = `${width}×${height}${png ? ", lossless" : ""}, ${render} + ${encode} ms` + (playing ? `, ${frames.length} frames/s` : "");
  if (playing) step();
}

// --- the view in the address, so that it can be shared (the secret is never there) ---

function toAddress() {
  const { eye, target, up, fov } = camera.state();
  // every digit, so that the picture is the same to the bit
  const of = new URLSearchParams({ eye: eye.join(","), target: target.join(","), up: up.join(","), fov, t: $("when").value, look: $("look").value });
  history.replaceState(null, "", `#${of}`);
}

function fromAddress() {
  const of = new URLSearchParams(location.hash.slice(1));
  const three = (name) => (of.get(name) ?? "").split(",").map(Number);
  const [eye, target, up, fov] = [three("eye"), three("target"), three("up"), Number(of.get("fov"))];
  if ([eye, target, up].every((v) => v.length === 3 && v.every(Number.isFinite)) && fov > 0) camera.restore({ eye, target, up, fov });
  const time = Number(of.get("t"));
  if (of.has("t") && time >= 0 && time <= 1) setTime(time);
  if ([...$("look").options].some((o) => o.value === of.get("look"))) $("look").value = of.get("look");
}

// --- mouse, touch, keys ---

let drag = null;
const fingers = new Map();
canvas.addEventListener("pointerdown", (e) => {
  canvas.focus();
  canvas.setPointerCapture(e.pointerId);
  fingers.set(e.pointerId, [e.clientX, e.clientY]);
  drag = { x: e.clientX, y: e.clientY, moved: 0, button: e.button, shift: e.shiftKey, ctrl: e.ctrlKey, alt: e.altKey };
});
canvas.addEventListener("pointermove", (e) => {
  if (!drag || !fingers.has(e.pointerId)) return;
  const before = [...fingers.values()];
  fingers.set(e.pointerId, [e.clientX, e.clientY]);
  const [dx, dy] = [e.clientX - drag.x, e.clientY - drag.y];
  Object.assign(drag, { x: e.clientX, y: e.clientY, moved: drag.moved + Math.abs(dx) + Math.abs(dy) });
  if (drag.moved < 4) return;
  const width = Math.min(canvas.clientWidth, canvas.clientHeight);
  if (fingers.size === 2) {
    const after = [...fingers.values()];
    const apart = ([a, b]) => Math.hypot(a[0] - b[0], a[1] - b[1]);
    camera.dolly(apart(before) / Math.max(apart(after), 1));
    camera.pan(dx / width / 2, dy / width / 2);
  } else if (drag.button === 2 || drag.ctrl) camera.dolly(Math.exp((2 * dy) / width));
  else if (drag.button === 1 || drag.shift) camera.pan(dx / width, dy / width);
  else camera.orbit(dx / width, dy / width);
  look(true);
});
const release = (e) => {
  fingers.delete(e.pointerId);
  if (drag && e.type === "pointerup" && drag.moved < 4 && drag.button === 0) click(e);
  else look(false);
  if (!fingers.size) drag = null;
};
canvas.addEventListener("pointerup", release);
canvas.addEventListener("pointercancel", release);
canvas.addEventListener("contextmenu", (e) => e.preventDefault());
canvas.addEventListener("wheel", (e) => {
  e.preventDefault();
  camera.dolly(Math.exp(Math.sign(e.deltaY) * Math.min(Math.abs(e.deltaY), 200) / 800));
  look(true);
}, { passive: false });

document.addEventListener("keydown", (e) => {
  if (e.ctrlKey && e.key.toLowerCase() === "z") {
    e.preventDefault();
    return change({ kind: "edits", undo: !e.shiftKey });
  }
  if (e.key === "Escape") return clear();
  if (/INPUT|SELECT|TEXTAREA/.test(document.activeElement?.tagName) && document.activeElement.type !== "range") return;
  if (e.ctrlKey || e.metaKey || !camera) return;
  const turn = 0.03;
  const keys = {
    ArrowLeft: () => camera.orbit(-turn, 0), ArrowRight: () => camera.orbit(turn, 0),
    ArrowUp: () => camera.orbit(0, -turn), ArrowDown: () => camera.orbit(0, turn),
    "+": () => camera.dolly(0.9), "-": () => camera.dolly(1 / 0.9),
    q: () => camera.roll(-0.05), e: () => camera.roll(0.05), r: () => camera.reset(),
  };
  if (document.activeElement?.type === "range" && e.key.startsWith("Arrow")) return;
  if (keys[e.key]) {
    e.preventDefault();
    keys[e.key]();
    return look(true);
  }
  if (e.key === " " && document.activeElement?.tagName !== "BUTTON") { e.preventDefault(); play(); }
  if (e.key === ",") nudge(-1);
  if (e.key === ".") nudge(1);
  if (e.key === "s") save();
  if (e.key === "Enter" && picked && document.activeElement === canvas) $("name").focus();
});

// --- time ---

const STEP = 0.01;
function setTime(t) {
  $("when").value = t;
  $("now").value = Number($("when").value).toFixed(3);
}
function nudge(by) {
  setTime(Math.min(1, Math.max(0, Number($("when").value) + by * STEP)));
  look(true);
}
function play() {
  playing = playing ? null : { from: performance.now(), at: Number($("when").value) % 1 };
  $("play").textContent = playing ? "⏸" : "▶";
  $("play").setAttribute("aria-label", playing ? "Stop" : "Play");
  if (playing) step();
  else look(false);
}
// the time that is due now, asked for when a frame has come: a slow machine leaves times out, and keeps the speed
function step() {
  const passed = (performance.now() - playing.from) / 1000 / Math.max(1, Number($("speed").value) || 5);
  let t = playing.at + passed;
  if (t > 1 && !$("loop").checked) {
    setTime(1);
    return play();
  }
  // on a grid, so that the second loop finds what the first deformed
  setTime(Math.round((t % 1) / STEP) * STEP);
  const before = lastView;
  look(true);
  if (before === lastView) setTimeout(() => playing && step(), 15);
}
$("play").onclick = play;
$("back").onclick = () => nudge(-1);
$("forth").onclick = () => nudge(1);
$("when").oninput = () => { setTime($("when").value); look(true); };
$("when").onchange = () => look(false);

// --- clicks and selections ---

async function click(e) {
  const box = canvas.getBoundingClientRect();
  const at = [(e.clientX - box.left) / box.width, (e.clientY - box.top) / box.height];
  const pixel = at.map((v, k) => Math.floor(v * [canvas.width, canvas.height][k]));
  const stage = $("stage").getBoundingClientRect();
  Object.assign($("marker").style, { left: `${e.clientX - stage.left}px`, top: `${e.clientY - stage.top}px` });
  $("marker").hidden = false;
  look(false);
  const combine = e.shiftKey ? "add" : e.altKey ? "remove" : "replace";
  await ask({ type: "pick", pixel, within: null, meaning: null, combine }).catch((message) => say(message, true));
}

function selected(message) {
  picked = message;
  stale();
  say("");
  const names = message.segments.length ? ` in ${message.segments.join(", ")}` : "";
  $("selected").textContent = `${message.gaussians.toLocaleString("en")} Gaussians${names} (${message.ms.toFixed(0)} ms)`;
  $("levels").replaceChildren(...message.levels.map((share, n) => {
    const button = document.createElement("button");
    button.textContent = `${n + 1}: ${(100 * share).toFixed(0)} %`;
    button.title = "Level, and its share of what is looked at";
    button.setAttribute("aria-pressed", n + 1 === message.level);
    button.onclick = () => adjust({ level: n + 1 });
    return button;
  }));
  $("scale").value = message.scale;
  $("cosine").value = Math.max(0, message.threshold);
}

// latest wins: one adjustment is on its way at a time
let adjusting = false, next = null;
async function adjust(meaning) {
  if (!picked) return;
  if (adjusting) { next = meaning; return; }
  adjusting = true;
  await ask({ type: "adjust", meaning }).catch((message) => say(message, true));
  adjusting = false;
  if (next) { const m = next; next = null; adjust(m); }
}
const byHand = () => adjust({ by: { scale: Number($("scale").value), threshold: Number($("cosine").value) } });
$("scale").oninput = byHand;
$("cosine").oninput = byHand;

function clear() {
  picked = null;
  stale();
  $("marker").hidden = true;
  $("levels").replaceChildren();
  if (welcome?.clicks) $("selected").textContent = "Click on the picture to select. Shift-click adds, Alt-click removes.";
  send({ type: "clear" });
}
$("clear").onclick = clear;
$("commit").onsubmit = async (e) => {
  e.preventDefault();
  const name = $("name").value.trim();
  if (!picked) return say("Click on something first.", true);
  if (!name) return say("Give it a name.", true);
  await ask({ type: "commit", base: doc.revision, name }).then(() => {
    $("name").value = "";
    clear();
    say(`${name} is a segment now.`);
  }).catch((message) => say(message, true));
};

// --- segments and edits ---

function read(message) {
  doc = message;
  stale();
  const names = new Set(doc.segments.map((s) => s.name));
  for (const set of [hidden, checked]) for (const name of set) if (!names.has(name)) set.delete(name);
  alone = alone.filter((name) => names.has(name));
  tree();
  $("edits").replaceChildren(...doc.edits.map((text) => {
    const item = document.createElement("li");
    item.textContent = text;
    return item;
  }));
  const [undo, redo] = doc.segment_steps;
  $("segments-undo").disabled = !undo;
  $("segments-redo").disabled = !redo;
  $("segments-undo").title = undo ? `Undo: ${undo}` : "Nothing to undo";
  $("segments-redo").title = redo ? `Redo: ${redo}` : "Nothing to redo";
  [$("edits-undo").disabled, $("edits-redo").disabled] = doc.edit_steps.map((there) => !there);
  look(false);
}

function tree() {
  const wanted = $("search").value.toLowerCase();
  const rows = doc.segments.filter((s) => s.name.toLowerCase().includes(wanted)).map((s) => {
    const row = document.createElement("li");
    row.style.paddingLeft = `${s.depth}em`;
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: checked.has(s.name) });
    box.setAttribute("aria-label", `Choose ${s.name}`);
    box.onchange = () => (box.checked ? checked.add(s.name) : checked.delete(s.name));
    const eye = document.createElement("button");
    const shown = () => {
      eye.textContent = hidden.has(s.name) ? "○" : "●";
      eye.setAttribute("aria-pressed", hidden.has(s.name));
    };
    eye.setAttribute("aria-label", `Leave ${s.name} out of the picture`);
    eye.title = "Leave it out of the picture; no edit";
    eye.onclick = () => {
      hidden.has(s.name) ? hidden.delete(s.name) : hidden.add(s.name);
      shown();
      look(false);
    };
    shown();
    const swatch = Object.assign(document.createElement("span"), { className: "swatch" });
    swatch.style.background = `rgb(${s.colour.map((c) => Math.round(255 * Math.min(1, Math.max(0, c)))).join(" ")})`;
    const name = Object.assign(document.createElement("span"), { className: "name", textContent: s.name });
    const count = Object.assign(document.createElement("span"), { className: "count", textContent: s.gaussians.toLocaleString("en") });
    row.append(box, eye, swatch, name, count);
    return row;
  });
  $("tree").replaceChildren(...rows);
}
$("search").oninput = tree;

const chosen = () => {
  if (!checked.size) say("Check one or more segments first.", true);
  return [...checked];
};
const edit = (operation) => { const segments = chosen(); if (segments.length) change({ kind: "edit", segments, operation }); };
const value = (id) => Number($(id).value);
$("coarse").onclick = () => {
  if (!doc.segments.length || confirm("All segments are replaced (undo brings them back). Go on?")) change({ kind: "coarse", time: value("when"), clusters: null });
};
$("group").onclick = () => {
  const segments = chosen();
  const name = segments.length && prompt("Name of the group");
  if (name) ask({ type: "change", base: doc.revision, change: { kind: "group", name, segments } }).catch((e) => say(e, true));
};
$("remove").onclick = () => { const segments = chosen(); if (segments.length) change({ kind: "remove", segments }); };
$("isolate").onclick = () => {
  alone = alone.length ? [] : chosen();
  $("isolate").setAttribute("aria-pressed", alone.length > 0);
  look(false);
};
$("segments-undo").onclick = () => change({ kind: "segments", undo: true });
$("segments-redo").onclick = () => change({ kind: "segments", undo: false });
$("edits-undo").onclick = () => change({ kind: "edits", undo: true });
$("edits-redo").onclick = () => change({ kind: "edits", undo: false });
$("recolour").onclick = () => {
  const rgb = [1, 3, 5].map((k) => parseInt($("paint").value.slice(k, k + 2), 16) / 255);
  edit({ recolour: { rgb, keep_shading: true } });
};
$("opacity").onclick = () => edit({ opacity: { factor: value("factor") } });
$("hide").onclick = () => edit("hide");
$("show").onclick = () => edit("show");
$("move").onclick = () => edit({ translate: { by: [value("dx"), value("dy"), value("dz")] } });
$("rotate").onclick = () => edit({ rotate: { axis: ["x", "y", "z"].map((a) => Number(a === $("axis").value)), degrees: value("degrees"), about: null } });
$("enlarge").onclick = () => edit({ scale: { factor: value("size"), about: null } });

// --- looks ---

$("look").onchange = () => look(false);
$("edits-on").onchange = () => look(false);
$("reset").onclick = () => { camera.reset(); look(false); };
for (const button of document.querySelectorAll("[data-axis]")) {
  button.onclick = () => {
    const { centre, radius } = camera.home;
    camera.look(centre, button.dataset.axis.split(",").map(Number), radius);
    look(false);
  };
}
function save() {
  if (!last) return say("The picture is not sharp yet; wait a moment.", true);
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(last), download: "volseggs.png" });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
$("save").onclick = save;
new ResizeObserver(() => look(false)).observe($("stage"));

connect();
