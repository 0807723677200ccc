// Charts of the checked segments through time: volume, centroid and speed, with the events of their parts.
import { $, element, make, value } from "./dom.js";
import { reveal } from "./panels.js";
import { place, valueAt } from "./plot-scale.js";
import { plot, upright } from "./plot.js";
import { chosen } from "./segments.js";
import { attempt, hear } from "./socket.js";
import { on } from "./state.js";
import { goTo, nudge } from "./time.js";
import { timeText, unit } from "./units.js";
/** @import { EventKind, Track, TrackEvent } from "./protocol" */
/** @import { Point } from "./plot-scale.js" */
/** @import { Vec2 } from "./types" */

/** @type {Vec2} */
const SPAN = [0, 1];
/** @type {Record<EventKind, string>} */
const LETTERS = { appear: "A", vanish: "V", split: "S", merge: "M", continue: "", segment_appear: "A", segment_vanish: "V" };
const MEANINGS = { A: "appears", V: "vanishes", S: "splits", M: "merges" };

/** @type {Track | null} */
let track = null;
/** @type {SVGElement[]} */
let nows = [];

/** @param {TrackEvent} event */
function words({ kind, parts: [before, after] }) {
  if (kind === "split") return `a part splits into ${after}`;
  if (kind === "merge") return `${before} parts merge into one`;
  const what = kind.startsWith("segment") ? "the whole" : "a part";
  return `${what} ${kind.endsWith("vanish") ? "vanishes" : "appears"}`;
}
/** @param {TrackEvent} event */
const described = (event) => `${timeText(event.to)} ${words(event)}`;

/** Marks of a chart: its events, those of one time as one mark with a tooltip, and the current time. @param {Track} track */
function marks(track) {
  /** @type {Map<number, TrackEvent[]>} */
  const times = new Map();
  for (const event of track.events) {
    const middle = (event.from + event.to) / 2;
    times.set(middle, [...(times.get(middle) ?? []), event]);
  }
  const events = [...times].map(([time, all]) => {
    const x = place(SPAN, time);
    const letters = [...new Set(all.map((event) => LETTERS[event.kind]))].join("");
    const title = element("title", {}, all.map(described).join("\n"));
    const around = element("rect", { x: x - 6, y: 0, width: 12, height: "100%", class: "around" });
    const letter = element("text", { x, y: 10, class: "letter", "text-anchor": "middle" }, letters);
    return element("g", {}, title, around, upright(SPAN, time, "event"), letter);
  });
  const now = upright(SPAN, value("when"), "now");
  nows.push(now);
  return [...events, now];
}

/** @param {Track} track */
function show(track) {
  nows = [];
  /** @param {(number | null)[]} values @param {string} look */
  const line = (values, look) => ({ points: track.times.map((t, k) => /** @type {Point} */ ([t, values[k]])), look });
  /** @param {number} k */
  const axis = (k) => track.centroid.map((c) => (c ? c[k] : null));
  const options = () => ({ span: SPAN, ends: SPAN.map(timeText), marks: marks(track) });
  plot($("chart-volume"), [line(track.volume, "one")], options());
  plot($("chart-centroid"), [line(axis(0), "one"), line(axis(1), "two"), line(axis(2), "three")], options());
  plot($("chart-speed"), [line(track.speed, "one")], options());
  const length = unit("length");
  $("unit-volume").textContent = `(${length === "normalised" ? length : `${length}³`})`;
  $("unit-centroid").textContent = `(${length})`;
  $("unit-speed").textContent = `(${unit("speed")})`;
  $("chart-title").textContent = track.segments.join(" + ");
  const used = Object.entries(MEANINGS).filter(([letter]) => track.events.some((event) => LETTERS[event.kind] === letter));
  $("chart-key").replaceChildren(...used.map(([letter, meaning]) => make("span", {}, make("b", { textContent: letter }), ` ${meaning}`)));
  $("events").replaceChildren(...track.events.map((event) => {
    const button = make("button", { title: "Go to this time" }, make("b", { textContent: LETTERS[event.kind] }), ` ${described(event)}`);
    button.onclick = () => goTo(event.to);
    return make("li", {}, button);
  }));
  reveal($("chart"));
  mark();
}

// marks the current time on the charts
function mark() {
  if (!track) return;
  const time = value("when");
  const line = upright(SPAN, time, "").getAttribute("d") ?? "";
  for (const now of nows) now.setAttribute("d", line);
  $("chart-time").setAttribute("aria-valuenow", time.toFixed(3));
  $("chart-time").setAttribute("aria-valuetext", `time ${timeText(time)}`);
}

$("chart-start").onclick = async () => {
  const segments = chosen();
  if (!segments.length) return;
  const label = $("chart-start").textContent;
  Object.assign($("chart-start"), { disabled: true, textContent: "measuring …" });
  await attempt({ type: "track", segments, times: 51 });
  Object.assign($("chart-start"), { disabled: false, textContent: label });
};
hear("track", (message) => { track = message; show(message); });

for (const id of /** @type {const} */ (["chart-volume", "chart-centroid", "chart-speed"])) {
  $(id).onclick = (e) => {
    const box = $(id).getBoundingClientRect();
    goTo(valueAt(SPAN, (e.clientX - box.left) / box.width));
  };
}
$("chart-time").onkeydown = (e) => {
  /** @type {Record<string, () => void>} */
  const keys = {
    ArrowLeft: () => nudge(-1), ArrowDown: () => nudge(-1), ArrowRight: () => nudge(1), ArrowUp: () => nudge(1),
    Home: () => goTo(0), End: () => goTo(1),
  };
  if (!keys[e.key]) return;
  // elsewhere, these keys turn the scene
  e.preventDefault();
  e.stopPropagation();
  keys[e.key]();
  mark();
};
on("frame", mark);
on("document", ({ segments, renamed }) => {
  const names = new Map(renamed);
  if (track) track.segments = track.segments.map((name) => names.get(name) ?? name);
  $("chart-title").textContent = track?.segments.join(" + ") ?? "";
  if (!track || track.segments.every((name) => segments.some((s) => s.name === name))) return;
  track = null;
  $("chart").hidden = true;
});
