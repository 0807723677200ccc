import assert from "node:assert/strict";
import test from "node:test";
import { BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, extent, linePath, place, valueAt } from "../../../src/view/page/plot-scale.js";

test("positions and values are inverse, and values stay within the span", () => {
  assert.deepEqual([place([2, 4], 2), place([2, 4], 4)], [LEFT, WIDTH - RIGHT]);
  for (const x of [2, 2.5, 4]) assert.ok(Math.abs(valueAt([2, 4], place([2, 4], x) / WIDTH) - x) < 1e-12);
  assert.deepEqual([valueAt([2, 4], 0), valueAt([2, 4], 1)], [2, 4]);
  assert.equal(place([3, 3], 3), LEFT, "an empty span");
});

test("missing values do not count", () => {
  assert.equal(extent([]), null);
  assert.equal(extent([[0, null], [1, NaN]]), null);
  assert.deepEqual(extent([[0, null], [1, 5], [3, -2]]), { xs: [1, 3], ys: [-2, 5] });
});

test("a line is interrupted where values are missing, and a single point is a dot", () => {
  const low = (HEIGHT - BOTTOM).toFixed(1), high = TOP.toFixed(1);
  assert.equal(linePath([[0, 0], [1, 1]], [0, 1], [0, 1]), `M4.0 ${low}L296.0 ${high}`);
  assert.equal(linePath([[0, 0], [0.5, null], [1, 1]], [0, 1], [0, 1]), `M4.0 ${low}M296.0 ${high}`);
  assert.equal(linePath([[0, null], [1, 7]], [0, 1], [7, 7]), `M296.0 ${low}h0`);
  assert.equal(linePath([[0, null]], [0, 1], [0, 1]), "");
});
