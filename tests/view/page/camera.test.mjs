import assert from "node:assert/strict";
import test from "node:test";
import { Camera, cross, dot, length, pictureFov, sub, trainingFov, unit } from "../../../src/view/page/camera.js";

const near = (a, b) => assert.ok(Math.abs(a - b) < 1e-9, `${a} is not ${b}`);
const nearAll = (a, b) => a.forEach((v, k) => near(v, b[k]));
const distance = (camera) => length(sub(camera.eye, camera.target));

test("a new camera looks at the centre from its distance, with z up", () => {
  const camera = new Camera([1, 2, 3], 4, 0.5);
  assert.deepEqual([camera.target, camera.up, camera.fov], [[1, 2, 3], [0, 0, 1], 0.5]);
  near(distance(camera), 4);
});

test("its axes are orthonormal and right-handed", () => {
  const camera = new Camera([0, 0, 0], 2, 0.5);
  camera.orbit(0.3, 0.2);
  camera.roll(0.4);
  const { forward, right, up } = camera.axes();
  for (const axis of [forward, right, up]) near(length(axis), 1);
  for (const [a, b] of [[forward, right], [right, up], [up, forward]]) near(dot(a, b), 0);
  nearAll(cross(right, forward), up);
});

test("turning keeps the distance and comes back", () => {
  const camera = new Camera([1, 0, 0], 3, 0.5);
  const before = camera.state();
  camera.orbit(0.25, 0);
  near(distance(camera), 3);
  assert.ok(dot(unit(sub(before.eye, before.target)), unit(sub(camera.eye, camera.target))) < 0.9);
  camera.orbit(-0.25, 0);
  nearAll(camera.eye, before.eye);
  for (let k = 0; k < 8; k++) camera.orbit(0.25, 0);
  nearAll(camera.eye, before.eye);
});

test("panning moves eye and target alike, by the width of what is shown", () => {
  const camera = new Camera([0, 0, 0], 2, 1);
  const { eye } = camera;
  camera.pan(1, 0);
  nearAll(sub(camera.eye, eye), camera.target);
  near(length(camera.target), 2 * 2 * Math.tan(0.5));
});

test("dolly, roll, centre and reset", () => {
  const camera = new Camera([0, 0, 0], 2, 1);
  const home = camera.state();
  camera.dolly(0.5);
  near(distance(camera), 1);
  camera.roll(Math.PI / 2);
  near(dot(camera.axes().up, [0, 0, 1]), 0);
  camera.centreOn([5, 5, 5]);
  assert.deepEqual(camera.target, [5, 5, 5]);
  near(distance(camera), 1);
  camera.reset();
  assert.deepEqual(camera.state(), home);
  camera.lookFrom([0, 0, 1]);
  assert.deepEqual([camera.eye, camera.up], [[0, 0, 2], [0, 1, 0]], "z cannot be up in a view along it");
});

test("a wide picture shows all that a training image shows, and the conversion has an inverse", () => {
  assert.equal(pictureFov(0.8, [400, 800], [400, 400]), 0.8, "a narrow one has the same width");
  near(Math.tan(pictureFov(0.8, [800, 400], [400, 400]) / 2), 2 * Math.tan(0.4));
  for (const size of [[800, 400], [400, 800]]) near(trainingFov(pictureFov(0.8, size, [640, 480]), size, [640, 480]), 0.8);
});
