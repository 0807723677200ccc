import assert from "node:assert/strict";
import test from "node:test";
import { Listeners } from "../../../src/view/page/listeners.js";

test("all listeners of an event are called, in order, until they stop", () => {
  const listeners = new Listeners(), calls = [];
  const stop = listeners.on("a", (what) => calls.push(["first", what]));
  listeners.on("a", (what) => calls.push(["second", what]));
  listeners.on("b", (what) => calls.push(["other", what]));
  listeners.emit("a", 1);
  stop();
  stop();
  listeners.emit("a", 2);
  listeners.emit("c", 3);
  assert.deepEqual(calls, [["first", 1], ["second", 1], ["second", 2]]);
});

test("a listener may stop itself or add another while it is called", () => {
  const listeners = new Listeners(), calls = [];
  const stop = listeners.on("a", () => {
    calls.push("once");
    stop();
    listeners.on("a", () => calls.push("later"));
  });
  listeners.on("a", () => calls.push("always"));
  listeners.emit("a", undefined);
  assert.deepEqual(calls, ["once", "always"]);
  listeners.emit("a", undefined);
  assert.deepEqual(calls, ["once", "always", "always", "later"]);
});
