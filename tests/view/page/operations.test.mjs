import assert from "node:assert/strict";
import test from "node:test";
import { fade, hex, recolour } from "../../../src/view/page/operations.js";

test("colours go to inputs and back", () => {
  assert.equal(hex([0, 0.5, 2]), "#0080ff");
  assert.deepEqual(recolour("#3300ff"), { recolour: { rgb: [0.2, 0, 1], keep_shading: true } });
});

test("an opacity becomes the edit that leads to it, if one is needed", () => {
  assert.equal(fade({ hidden: false, opacity: 0.5 }, 0), "hide");
  assert.equal(fade({ hidden: true, opacity: 0.5 }, 0), null);
  assert.equal(fade({ hidden: false, opacity: 0.5 }, 0.5), null);
  assert.equal(fade({ hidden: true, opacity: 0.5 }, 0.5), "show");
  assert.deepEqual(fade({ hidden: false, opacity: 0.5 }, 1), { opacity: { factor: 2, show: false } });
  assert.deepEqual(fade({ hidden: true, opacity: 0 }, 1), { opacity: { factor: 1000, show: true } });
});
