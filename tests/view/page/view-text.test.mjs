import assert from "node:assert/strict";
import test from "node:test";
import { fromHash, savedView, textOf, toHash } from "../../../src/view/page/view-text.js";

const view = {
  eye: [1, -2.5, 1 / 3], target: [0, 0, 0], up: [0, 0, 1], fov: 0.8, time: 0.3, look: "velocity x", palette: "cool-warm",
  alone: ["a", "b"], hidden: ["c"], edits: false, range: [-1, 0.1],
};

test("a view in the address comes back with all its digits", () => {
  assert.deepEqual(fromHash(toHash(view)), view);
});

test("what is not stated has its usual value", () => {
  const plain = { ...view, palette: "", alone: [], hidden: new Set(), edits: true, range: null };
  const hash = toHash(plain);
  for (const name of ["alone", "hidden", "edits", "palette", "range"]) assert.ok(!hash.includes(name), hash);
  const { alone, hidden, edits, palette, range } = fromHash(hash);
  assert.deepEqual([alone, hidden, edits, palette], [[], [], true, null]);
  assert.ok(range.some(Number.isNaN), "which is no range");
});

test("an address without a camera holds no view", () => {
  for (const hash of ["", "#", "#t=0.5", toHash({ ...view, eye: [1, NaN, 2] }), toHash({ ...view, fov: 0 })]) assert.equal(fromHash(hash), null);
});

test("anything else in a file is refused, and odd names are left out", () => {
  for (const read of [null, 3, "x", [], {}, { view: { eye: ["<b>"] } }, { ...view, up: [0, 1] }]) assert.equal(savedView(read), null);
  const saved = savedView({ view: { ...view, alone: ["a", 3], hidden: "c" }, scene: "s", run: "r" });
  assert.deepEqual(saved, { view: { ...view, alone: ["a"], hidden: [] }, scene: "s", run: "r" });
  assert.deepEqual(savedView(view).view, view, "a bare view");
  const keys = [{ seconds: 0 }];
  assert.deepEqual(savedView({ keys, view }), { path: { keys, view } });
});

const chunk = (kind, text) => {
  const bytes = new TextEncoder().encode(text), out = new Uint8Array(12 + bytes.length);
  new DataView(out.buffer).setUint32(0, bytes.length);
  out.set(new TextEncoder().encode(kind), 4);
  out.set(bytes, 8);
  return out;
};
const SIGNATURE = Uint8Array.from([0x89, 0x50, 0x4e, 0x47, 13, 10, 26, 10]);

test("the text of a view is found in a picture, and only before its pixels", async () => {
  const text = chunk("iTXt", "volseggs view\0\0\0\0\0{\"a\":\"é\"}");
  assert.equal(await textOf(new Blob([SIGNATURE, chunk("IHDR", "x".repeat(13)), text])), "{\"a\":\"é\"}");
  assert.equal(await textOf(new Blob([SIGNATURE, chunk("IDAT", "x"), text])), "");
  assert.equal(await textOf(new Blob([SIGNATURE, chunk("iTXt", "other\0\0\0\0\0x")])), "");
  assert.equal(await textOf(new Blob([SIGNATURE, text.slice(0, 20)])), "", "cut off");
  assert.equal(await textOf(new Blob(["{}"])), "{}");
  assert.equal(await textOf(new Blob(["x".repeat(70_000)])), "", "too long");
});
