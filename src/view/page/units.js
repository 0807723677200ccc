// Units of what is shown: those of the data where the run knows them. Messages of the server are in scene units.
import { app } from "./state.js";

const space = () => app.welcome?.calibration.space;
const times = () => app.welcome?.calibration.time;
export const unit = (kind) => app.welcome?.units[kind] ?? "normalised";

// a scene unit in the data's unit of length
export const scale = () => space()?.scale ?? 1;

export const lengthText = (v) => `${(scale() * v).toPrecision(3)}${space() ? ` ${unit("length")}` : " (normalised)"}`;
export const timeText = (t) => {
  if (!times()) return t.toFixed(3);
  const { start, end } = times();
  return `${Number((start * (1 - t) + end * t).toPrecision(6))} ${unit("time")}`;
};
