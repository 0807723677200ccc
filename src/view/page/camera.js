// The camera: an eye that orbits a target. Vectors are arrays of three numbers, in scene units.
/** @import { Vec2, Vec3 } from "./types" */

/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @type {(a: Vec3, s: number) => Vec3} */
export const mul = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
/** @type {(a: Vec3, b: Vec3) => number} */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @type {(a: Vec3) => number} */
export const length = (a) => Math.sqrt(dot(a, a));
/** @type {(a: Vec3) => Vec3} */
export const unit = (a) => mul(a, 1 / Math.max(length(a), 1e-12));

/**
 * Rotates v about a unit axis by an angle, right-handed.
 * @type {(v: Vec3, axis: Vec3, angle: number) => Vec3}
 */
function turn(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return add(add(mul(v, c), mul(cross(axis, v), s)), mul(axis, dot(axis, v) * (1 - c)));
}

/**
 * Ratio of the tangents of half the field of view of a picture to that of a training image, if the picture shows all
 * that the image does. Sizes are width and height.
 * @type {(size: Vec2, trained: Vec2) => number}
 */
const widening = ([width, height], [w, h]) => Math.max(1, width / height / (w / h));

/**
 * Field of view of a picture of this size that shows all that a training image with the field of view does.
 * @type {(fov: number, size: Vec2, trained: Vec2) => number}
 */
export const pictureFov = (fov, size, trained) => 2 * Math.atan(Math.tan(fov / 2) * widening(size, trained));

/**
 * The inverse of `pictureFov`.
 * @type {(fov: number, size: Vec2, trained: Vec2) => number}
 */
export const trainingFov = (fov, size, trained) => 2 * Math.atan(Math.tan(fov / 2) / widening(size, trained));

export class Camera {
  /** @type {Vec3} */ eye = [0, 0, 0];
  /** @type {Vec3} */ target = [0, 0, 0];
  /** @type {Vec3} */ up = [0, 0, 1];
  /** Horizontal field of view of a training image, radians. */
  fov = 0;

  /**
   * @param {Vec3} centre what it looks at first
   * @param {number} radius from how far
   * @param {number} fov radians
   */
  constructor(centre, radius, fov) {
    this.home = { centre, radius, fov };
    this.reset();
  }

  reset() {
    this.lookFrom(unit([1, -0.25, 0.35]));
  }

  /** Looks at the centre again, from this direction. @param {Vec3} direction */
  lookFrom(direction) {
    const { centre, radius, fov } = this.home;
    this.fov = fov;
    this.target = [...centre];
    this.eye = add(centre, mul(unit(direction), radius));
    const along = Math.abs(unit(direction)[2]) > 0.999;
    this.up = along ? [0, 1, 0] : [0, 0, 1];
  }

  axes() {
    const forward = unit(sub(this.target, this.eye));
    const right = unit(cross(forward, this.up));
    return { forward, right, up: cross(right, forward) };
  }

  /** Turns about the target. @param {number} dx fraction of the picture's width @param {number} dy the same */
  orbit(dx, dy) {
    const { right, up } = this.axes();
    let arm = sub(this.eye, this.target);
    arm = turn(arm, up, -dx * Math.PI);
    arm = turn(arm, right, -dy * Math.PI);
    this.eye = add(this.target, arm);
    this.up = unit(turn(up, right, -dy * Math.PI));
  }

  /** Moves along the picture. @param {number} dx fraction of its width @param {number} dy the same */
  pan(dx, dy) {
    const { right, up } = this.axes();
    const width = 2 * length(sub(this.eye, this.target)) * Math.tan(this.fov / 2);
    const by = add(mul(right, -dx * width), mul(up, dy * width));
    this.eye = add(this.eye, by);
    this.target = add(this.target, by);
  }

  /** Moves the target, and the eye with it. @param {Vec3} target */
  centreOn(target) {
    this.eye = add(target, sub(this.eye, this.target));
    this.target = target;
  }

  /** @param {number} factor by which the distance to the target changes */
  dolly(factor) {
    this.eye = add(this.target, mul(sub(this.eye, this.target), factor));
  }

  /** @param {number} angle radians */
  roll(angle) {
    const { forward, up } = this.axes();
    this.up = turn(up, forward, angle);
  }

  state() {
    return { eye: this.eye, target: this.target, up: this.up, fov: this.fov };
  }

  /** @param {{ eye: Vec3, target: Vec3, up: Vec3, fov: number }} state */
  restore({ eye, target, up, fov }) {
    Object.assign(this, { eye, target, up, fov });
  }
}
