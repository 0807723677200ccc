import assert from "node:assert/strict";
import test from "node:test";
import { cameraDue, secondsAfter, timeDue } from "../../../src/view/page/playback.js";

test("the time that is due is on a grid and keeps the speed", () => {
  const playing = { from: 1000, at: 0.5 };
  assert.equal(timeDue(playing, 1000, 5, false), 0.5);
  assert.equal(timeDue(playing, 2000, 5, false), 0.7000000000000001);
  assert.equal(timeDue(playing, 2012, 5, false), timeDue(playing, 2000, 5, false));
  assert.equal(timeDue(playing, 1400, 0.1, false), 0.9, "at most all times in a second");
});

test("at the end it stops or begins again", () => {
  const playing = { from: 0, at: 0.5 };
  assert.equal(timeDue(playing, 2500, 5, false), null);
  assert.equal(timeDue(playing, 3000, 5, false), null);
  assert.equal(timeDue(playing, 3000, 5, true), 0.1);
});

test("cameras of a path are due at their rate, keyframes after the last", () => {
  assert.deepEqual([cameraDue(500, 500, 30), cameraDue(500, 1500, 30)], [0, 30]);
  assert.equal(secondsAfter([], 2), 0);
  assert.equal(secondsAfter([{ seconds: 0 }, { seconds: 3 }], 2), 5);
  assert.equal(secondsAfter([{ seconds: 3 }], -1), 3.1);
});
