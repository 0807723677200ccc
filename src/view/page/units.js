// Numbers in words, in the units of the data where the run knows them. Messages of the viewer are in scene units.
import { app } from "./state.js";

const space = () => app.welcome?.calibration.space;
const times = () => app.welcome?.calibration.time;

/** @param {"length" | "time" | "speed"} kind */
export const unit = (kind) => app.welcome?.units[kind] ?? "normalised";

/** A scene unit in the data's unit of length. */
export const scale = () => space()?.scale ?? 1;

/** @param {number} v in scene units */
export const lengthText = (v) => `${(scale() * v).toPrecision(3)}${space() ? ` ${unit("length")}` : " (normalised)"}`;

/** @param {number} t in [0, 1] */
export const timeText = (t) => {
  const range = times();
  if (!range) return t.toFixed(3);
  return `${Number((range.start * (1 - t) + range.end * t).toPrecision(6))} ${unit("time")}`;
};

/** @param {number} seconds */
export const duration = (seconds) =>
  seconds < 90 ? `${seconds.toFixed(0)} s` : seconds < 5400 ? `${(seconds / 60).toFixed(1)} min` : `${(seconds / 3600).toFixed(1)} h`;

/** A number with separators of thousands. @param {number} n */
export const count = (n) => n.toLocaleString("en");

/** A number at the end of a scale. @param {number} v */
export const short = (v) => {
  if (Number.isInteger(v)) return count(v);
  return Math.abs(v) >= 1e4 || Math.abs(v) < 1e-3 ? v.toExponential(1) : Number(v.toPrecision(3)).toString();
};
