// Scales of line plots: where values are in the plot.
/** @import { Vec2 } from "./types" */
/** @typedef {readonly [number, number | null]} Point x and y; null where it is missing */

export const WIDTH = 300, HEIGHT = 96, LEFT = 4, RIGHT = 4, TOP = 14, BOTTOM = 14;

/**
 * Position in the plot of a value on the horizontal axis, which covers the span.
 * @type {(span: Vec2, x: number) => number}
 */
export const place = ([from, to], x) => LEFT + ((x - from) / (to - from || 1)) * (WIDTH - LEFT - RIGHT);

/**
 * The value on the horizontal axis at this share of the plot's width.
 * @type {(span: Vec2, share: number) => number}
 */
export const valueAt = ([from, to], share) => {
  const part = (share * WIDTH - LEFT) / (WIDTH - LEFT - RIGHT);
  return from + Math.min(1, Math.max(0, part)) * (to - from);
};

/** @type {(point: Point) => point is readonly [number, number]} */
const there = (point) => point[1] !== null && Number.isFinite(point[1]);

/**
 * Smallest and largest x and y of all points, or null if there are none.
 * @param {Point[]} points
 * @returns {{ xs: Vec2, ys: Vec2 } | null}
 */
export function extent(points) {
  const all = points.filter(there);
  if (!all.length) return null;
  const xs = all.map(([x]) => x), ys = all.map(([, y]) => y);
  return { xs: [Math.min(...xs), Math.max(...xs)], ys: [Math.min(...ys), Math.max(...ys)] };
}

/**
 * The path of a line, interrupted where y is missing; a single point becomes a dot.
 * @param {Point[]} points
 * @param {Vec2} xs values at the left and right end
 * @param {Vec2} ys values at the lower and upper end
 */
export function linePath(points, xs, [low, high]) {
  let pen = "M", drawn = 0, d = "";
  for (const point of points) {
    if (!there(point)) { pen = "M"; continue; }
    const up = HEIGHT - BOTTOM - ((point[1] - low) / (high - low || 1)) * (HEIGHT - TOP - BOTTOM);
    d += `${pen}${place(xs, point[0]).toFixed(1)} ${up.toFixed(1)}`;
    pen = "L";
    drawn += 1;
  }
  return drawn === 1 ? `${d}h0` : d;
}
