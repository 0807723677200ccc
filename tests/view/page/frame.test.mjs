import assert from "node:assert/strict";
import test from "node:test";
import { KINDS, header, picture } from "../../../src/view/page/frame.js";

test("the header is read as the viewer writes it", async () => {
  // the same bytes as in the test of src/view/protocol/frame.rs
  const text = "0101020009000000020000000000000020035802" + "0000803e0000404100004040";
  const bytes = Uint8Array.from([...text.match(/../g).map((byte) => parseInt(byte, 16)), 1, 2, 3]).buffer;
  assert.deepEqual(header(bytes), {
    png: true, kind: KINDS.still, number: 9, revision: 2, width: 800, height: 600, time: 0.25, ms: [12, 3],
  });
  const blob = picture(bytes, true);
  assert.deepEqual([blob.type, ...new Uint8Array(await blob.arrayBuffer())], ["image/png", 1, 2, 3]);
});
