// Line plots, drawn as SVG.
import { element } from "./state.js";

const WIDTH = 300, HEIGHT = 96, LEFT = 4, RIGHT = 4, TOP = 14, BOTTOM = 14;

const short = (v) => (Number.isInteger(v) ? v.toLocaleString("en") : Math.abs(v) >= 1e4 || Math.abs(v) < 1e-3 ? v.toExponential(1) : Number(v.toPrecision(3)).toString());
const label = (x, y, text, anchor = "start") => element("text", { x, y, "text-anchor": anchor }, text);

// converts a value on the horizontal axis, which covers span, to its position in the plot, and back
export const place = ([from, to], x) => LEFT + ((x - from) / (to - from || 1)) * (WIDTH - LEFT - RIGHT);
export const valueAt = ([from, to], share) => {
  const part = (share * WIDTH - LEFT) / (WIDTH - LEFT - RIGHT);
  return from + Math.min(1, Math.max(0, part)) * (to - from);
};

// plots lines of points [x, y], with y null where missing, on one scale; without a span, it runs from the smallest to
// the largest x; ends are texts for both ends of the span; marks are elements drawn over the lines
export function plot(svg, lines, { span = null, ends = null, unit = "", marks = [] } = {}) {
  const all = lines.flatMap((line) => line.points).filter(([, y]) => y !== null && Number.isFinite(y));
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  if (!all.length) return svg.replaceChildren();
  const [from, to] = span ?? [Math.min(...all.map(([x]) => x)), Math.max(...all.map(([x]) => x))];
  const [low, high] = [Math.min(...all.map(([, y]) => y)), Math.max(...all.map(([, y]) => y))];
  const up = (y) => HEIGHT - BOTTOM - ((y - low) / (high - low || 1)) * (HEIGHT - TOP - BOTTOM);
  const paths = lines.map(({ points, look = "one" }) => {
    let pen = "M";
    const steps = points.map(([x, y]) => {
      if (y === null || !Number.isFinite(y)) { pen = "M"; return ""; }
      const step = `${pen}${place([from, to], x).toFixed(1)} ${up(y).toFixed(1)}`;
      pen = "L";
      return step;
    });
    // a single point becomes a dot
    const d = steps.filter(Boolean).length === 1 ? `${steps.join("")}h0` : steps.join("");
    return element("path", { d, class: `line ${look}` });
  });
  const axis = element("path", { d: `M${LEFT} ${HEIGHT - BOTTOM}H${WIDTH - RIGHT}`, class: "axis" });
  svg.replaceChildren(
    axis, ...paths, ...marks,
    label(LEFT, 10, `${short(high)}${unit}`), label(LEFT, HEIGHT - BOTTOM - 2, short(low)),
    label(LEFT, HEIGHT - 2, ends?.[0] ?? short(from)), label(WIDTH - RIGHT, HEIGHT - 2, ends?.[1] ?? short(to), "end"),
  );
  return [from, to];
}

// a vertical line at x
export const upright = (span, x, look) => {
  const at = place(span, x).toFixed(1);
  return element("path", { d: `M${at} ${TOP}V${HEIGHT - BOTTOM}`, class: look });
};
