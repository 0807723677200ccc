// The camera: an eye that orbits a target. Vectors are arrays of three numbers, in scene units.

export const add = (a, b) => a.map((v, k) => v + b[k]);
export const sub = (a, b) => a.map((v, k) => v - b[k]);
export const mul = (a, s) => a.map((v) => v * s);
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.sqrt(dot(a, a));
export const unit = (a) => mul(a, 1 / Math.max(length(a), 1e-12));

// rotates v about a unit axis by an angle, right-handed
function turn(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return add(add(mul(v, c), mul(cross(axis, v), s)), mul(axis, dot(axis, v) * (1 - c)));
}

export class Camera {
  constructor(centre, radius, fov) {
    this.home = { centre, radius, fov };
    this.reset();
  }

  reset() {
    const { centre, radius, fov } = this.home;
    this.fov = fov;
    this.look(centre, unit([1, -0.25, 0.35]), radius);
  }

  // places the eye in this direction from the target
  look(target, direction, distance) {
    this.target = [...target];
    this.eye = add(target, mul(unit(direction), distance));
    const along = Math.abs(unit(direction)[2]) > 0.999;
    this.up = along ? [0, 1, 0] : [0, 0, 1];
  }

  axes() {
    const forward = unit(sub(this.target, this.eye));
    const right = unit(cross(forward, this.up));
    return { forward, right, up: cross(right, forward) };
  }

  // dx and dy are fractions of the picture's width
  orbit(dx, dy) {
    const { right, up } = this.axes();
    let arm = sub(this.eye, this.target);
    arm = turn(arm, up, -dx * Math.PI);
    arm = turn(arm, right, -dy * Math.PI);
    this.eye = add(this.target, arm);
    this.up = unit(turn(up, right, -dy * Math.PI));
  }

  pan(dx, dy) {
    const { right, up } = this.axes();
    const width = 2 * length(sub(this.eye, this.target)) * Math.tan(this.fov / 2);
    const by = add(mul(right, -dx * width), mul(up, dy * width));
    this.eye = add(this.eye, by);
    this.target = add(this.target, by);
  }

  dolly(factor) {
    this.eye = add(this.target, mul(sub(this.eye, this.target), factor));
  }

  roll(angle) {
    const { forward, up } = this.axes();
    this.up = turn(up, forward, angle);
  }

  state() {
    return { eye: this.eye, target: this.target, up: this.up, fov: this.fov };
  }

  restore({ eye, target, up, fov }) {
    Object.assign(this, { eye, target, up, fov });
  }
}
