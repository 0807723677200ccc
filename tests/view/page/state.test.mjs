import assert from "node:assert/strict";
import test from "node:test";
import * as state from "../../../src/view/page/state.js";

const { app } = state;
const doc = (names, renamed = []) => ({
  revision: 7, renamed, segments: names.map((name) => ({ name })), edits: [], segment_steps: [null, null], edit_steps: [false, false],
});

test("a renamed segment stays checked, hidden and isolated, a removed one does not", () => {
  state.setDocument(doc(["a", "b", "c"]));
  state.setHidden(["a", "c"]);
  state.setChecked(["a", "b"], true);
  state.setAlone(["b", "a"]);
  const renamed = state.setDocument(doc(["x", "c"], [["a", "x"], ["c", "never"]]));
  assert.deepEqual([...renamed], [["a", "x"]], "only what was there and is now");
  assert.deepEqual([[...app.hidden], [...app.checked], app.alone], [["x", "c"], ["x"], ["x"]]);
});

test("a name that was reused is not followed", () => {
  state.setDocument(doc(["a", "b"]));
  state.setHidden([]);
  state.setChecked(["a"], true);
  state.setDocument(doc(["a", "b"], [["a", "b"]]));
  assert.deepEqual([...app.checked], ["a"]);
});

test("segments are checked, unchecked, hidden and shown one by one or together", () => {
  state.setDocument(doc(["a", "b", "c"]));
  state.setChecked(["a", "b", "c"], true);
  state.setChecked(["b"], false);
  assert.deepEqual([...app.checked], ["a", "c"]);
  state.toggleHidden("b");
  state.toggleHidden("c");
  state.toggleHidden("b");
  assert.deepEqual([...app.hidden], ["c"]);
});

test("a preview belongs to the present document, and ends with it", () => {
  state.setDocument(doc(["a"]));
  state.setPreview([{ segments: ["a"], operation: "hide" }]);
  assert.deepEqual(app.preview, { base: 7, edits: [{ segments: ["a"], operation: "hide" }] });
  state.setDocument(doc(["a"]));
  assert.equal(app.preview, null);
  state.setPreview([]);
  assert.deepEqual(app.preview, { base: 7, edits: [] });
  state.setPreview(null);
  assert.equal(app.preview, null);
});
