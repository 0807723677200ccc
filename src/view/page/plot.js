// Line plots, drawn as SVG.
import { element } from "./dom.js";
import { BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, extent, linePath, place } from "./plot-scale.js";
import { short } from "./units.js";
/** @import { Point } from "./plot-scale.js" */
/** @import { Vec2 } from "./types" */

/** @param {number} x @param {number} y @param {string} text @param {string} [anchor] */
const label = (x, y, text, anchor = "start") => element("text", { x, y, "text-anchor": anchor }, text);

/**
 * Plots lines on one scale.
 * @param {SVGSVGElement} svg
 * @param {{ points: Point[], look?: string }[]} lines
 * @param {object} options
 * @param {Vec2 | null} [options.span] of the horizontal axis; from the smallest to the largest x without
 * @param {string[] | null} [options.ends] texts for both ends of the span
 * @param {string} [options.unit] of the largest y
 * @param {SVGElement[]} [options.marks] drawn over the lines
 */
export function plot(svg, lines, { span = null, ends = null, unit = "", marks = [] } = {}) {
  const all = extent(lines.flatMap((line) => line.points));
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  if (!all) return svg.replaceChildren();
  const xs = span ?? all.xs, [low, high] = all.ys;
  const paths = lines.map(({ points, look = "one" }) => element("path", { d: linePath(points, xs, all.ys), class: `line ${look}` }));
  const axis = element("path", { d: `M${LEFT} ${HEIGHT - BOTTOM}H${WIDTH - RIGHT}`, class: "axis" });
  svg.replaceChildren(
    axis, ...paths, ...marks,
    label(LEFT, 10, `${short(high)}${unit}`), label(LEFT, HEIGHT - BOTTOM - 2, short(low)),
    label(LEFT, HEIGHT - 2, ends?.[0] ?? short(xs[0])), label(WIDTH - RIGHT, HEIGHT - 2, ends?.[1] ?? short(xs[1]), "end"),
  );
}

/**
 * A vertical line at x.
 * @param {Vec2} span
 * @param {number} x
 * @param {string} look
 */
export const upright = (span, x, look) => {
  const at = place(span, x).toFixed(1);
  return element("path", { d: `M${at} ${TOP}V${HEIGHT - BOTTOM}`, class: look });
};
