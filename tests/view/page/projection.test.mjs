import assert from "node:assert/strict";
import test from "node:test";
import { Camera, add, mul } from "../../../src/view/page/camera.js";
import { along, projection, ring, turned } from "../../../src/view/page/projection.js";

const near = (a, b, apart = 1e-6) => assert.ok(Math.abs(a - b) < apart, `${a} is not ${b}`);

// looks from x = 4 along -x; y is to the right, z up
const camera = new Camera([0, 0, 0], 4, 0.9);
camera.lookFrom([1, 0, 0]);
const view = projection(camera.eye, camera.axes(), 0.9, [800, 600]);

test("the target is in the middle, and what is behind the eye nowhere", () => {
  assert.deepEqual(view.project([0, 0, 0]), [400, 300]);
  assert.equal(view.project([5, 0, 0]), null);
  const [x, y] = view.project([0, 1, 1]);
  assert.ok(x > 400 && y < 300, "right and up");
});

test("a pixel's ray goes through what is projected there", () => {
  const p = [-1, 0.4, -0.7];
  const ray = view.ray(view.project(p));
  const there = add(view.eye, mul(ray, (p[0] - view.eye[0]) / ray[0]));
  there.forEach((v, k) => near(v, p[k]));
  near(view.project([0, view.pixel([0, 0, 0]), 0])[0], 401);
});

test("a handle follows the pointer along its axis", () => {
  near(along([0, 0, 0], [0, 0, 1], view.project([0, 0, 0.5]), view), 0.5);
  near(along([0, 0, 0], [0, 1, 0], view.project([0, -0.25, 0]), view), -0.25);
});

test("a ring turns by the angle of the pointer about its centre, right-handed", () => {
  const pixels = [[0, 1, 0], [0, 0, 1]].map(view.project);
  near(turned([0, 0, 0], [1, 0, 0], pixels, view, 60), 90);
  near(turned([0, 0, 0], [1, 0, 0], pixels.reverse(), view, 60), -90);
  // edge-on: by the movement across the axis
  near(Math.abs(turned([0, 0, 0], [0, 0, 1], [[400, 300], [460, 300]], view, 60)), 180 / Math.PI, 1e-3);
  near(turned([0, 0, 0], [0, 0, 1], [[400, 300], [400, 360]], view, 60), 0);
});

test("only the half of a ring that faces the eye is drawn, as one line", () => {
  assert.equal(ring([0, 0, 0], [1, 0, 0], 1, view).length, 65, "seen from its axis, it is whole");
  const half = ring([0, 0, 0], [0, 0, 1], 1, view);
  assert.ok(half.length > 30 && half.length < 40, `${half.length} points`);
  const steps = half.slice(1).map((p, k) => Math.hypot(p[0] - half[k][0], p[1] - half[k][1]));
  assert.ok(Math.max(...steps) < 30, "it does not jump");
});
