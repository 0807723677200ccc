// How a camera projects points onto the picture, and how movements on the picture become movements in the scene.
import { add, cross, dot, mul, sub, unit } from "./camera.js";
/** @import { Vec2, Vec3 } from "./types" */
/** @typedef {ReturnType<typeof projection>} Projection */

/**
 * Projections of points, and rays of pixels. Pixels are counted from the upper left corner.
 * @param {Vec3} eye
 * @param {{ forward: Vec3, right: Vec3, up: Vec3 }} axes
 * @param {number} fov horizontal, radians
 * @param {Vec2} size width and height
 */
export function projection(eye, { forward, right, up }, fov, [width, height]) {
  const focal = width / 2 / Math.tan(fov / 2);
  return {
    eye,
    /** Null for a point behind the camera. @param {Vec3} p @returns {Vec2 | null} */
    project(p) {
      const v = sub(p, eye), z = dot(v, forward);
      return z > 1e-9 ? [width / 2 + (focal * dot(v, right)) / z, height / 2 - (focal * dot(v, up)) / z] : null;
    },
    /** @param {Vec2} pixel */
    ray: ([x, y]) => unit(add(forward, add(mul(right, (x - width / 2) / focal), mul(up, (height / 2 - y) / focal)))),
    /** Size of a pixel at a point, in scene units. @param {Vec3} p */
    pixel: (p) => dot(sub(p, eye), forward) / focal,
  };
}

/**
 * Position along the line through p at which it is closest to the pixel's ray.
 * @type {(p: Vec3, axis: Vec3, pixel: Vec2, view: Projection) => number}
 */
export function along(p, axis, pixel, { eye, ray }) {
  const d = ray(pixel), w = sub(p, eye), b = dot(axis, d);
  return (b * dot(d, w) - dot(axis, w)) / Math.max(1 - b * b, 1e-6);
}

/**
 * Intersection of the pixel's ray with the plane through p.
 * @type {(p: Vec3, normal: Vec3, pixel: Vec2, view: Projection) => Vec3}
 */
function across(p, normal, pixel, { eye, ray }) {
  const d = ray(pixel);
  return add(eye, mul(d, dot(sub(p, eye), normal) / dot(d, normal)));
}

/**
 * Degrees by which the axis through p turns while the pointer moves between two pixels.
 * @param {Vec3} p
 * @param {Vec3} axis
 * @param {[Vec2, Vec2]} pixels
 * @param {Projection} view
 * @param {number} radius of the ring that is dragged, in pixels
 */
export function turned(p, axis, [before, after], view, radius) {
  const sight = unit(sub(p, view.eye));
  if (Math.abs(dot(axis, sight)) > 0.25) {
    const a = sub(across(p, axis, before, view), p), b = sub(across(p, axis, after, view), p);
    return (Math.atan2(dot(cross(a, b), axis), dot(a, b)) * 180) / Math.PI;
  }
  // seen edge-on: movement across the axis on the screen, a ring's radius per radian
  const from = view.project(p), to = view.project(add(p, mul(axis, view.pixel(p))));
  if (!from || !to) return 0;
  const ux = to[0] - from[0], uy = to[1] - from[1], norm = Math.hypot(ux, uy) || 1;
  return ((after[1] - before[1]) * ux - (after[0] - before[0]) * uy) / norm / radius * (180 / Math.PI);
}

/**
 * The part of a ring about an axis that faces the eye, as one line of pixels.
 * @type {(p: Vec3, axis: Vec3, radius: number, view: Projection) => Vec2[]}
 */
export function ring(p, axis, radius, view) {
  const sight = unit(sub(p, view.eye));
  const side = unit(cross(axis, Math.abs(axis[2]) > 0.9 ? [1, 0, 0] : [0, 0, 1])), other = cross(axis, side);
  const points = [];
  for (let k = 0; k <= 64; k++) {
    const t = (k * Math.PI) / 32;
    const out = add(mul(side, Math.cos(t)), mul(other, Math.sin(t)));
    const hidden = dot(out, sight) > 0.05 && Math.abs(dot(axis, sight)) < 0.97;
    points.push(hidden ? null : view.project(add(p, mul(out, radius))));
  }
  // starts after the hidden half, so that the visible part is one line
  const gap = points.lastIndexOf(null);
  const line = gap < 0 ? points : [...points.slice(gap + 1), ...points.slice(1, gap + 1)];
  return line.filter((point) => point !== null);
}
