import assert from "node:assert/strict";
import test from "node:test";
import { setWelcome } from "../../../src/view/page/state.js";
import { count, duration, lengthText, scale, short, timeText, unit } from "../../../src/view/page/units.js";

test("without units, lengths and times are normalised", () => {
  assert.deepEqual([unit("length"), scale(), lengthText(0.5), timeText(0.25)], ["normalised", 1, "0.500 (normalised)", "0.250"]);
});

test("lengths and times are in the units of the data", () => {
  const calibration = { space: { centre: [0, 0, 0], scale: 72, unit: "mm" }, time: { start: 100, end: 300, unit: "s" } };
  setWelcome({ calibration, units: { length: "mm", time: "s", speed: "mm/s" } });
  assert.deepEqual([scale(), lengthText(0.1), timeText(0), timeText(0.25), timeText(1)], [72, "7.20 mm", "100 s", "150 s", "300 s"]);
  assert.equal(unit("speed"), "mm/s");
});

test("numbers are short", () => {
  assert.deepEqual([30, 89, 90, 5399, 5400].map(duration), ["30 s", "89 s", "1.5 min", "90.0 min", "1.5 h"]);
  assert.equal(count(1234567), "1,234,567");
  assert.deepEqual([12000, 0.123456, 0.00012, 12345.6, -3.14159].map(short), ["12,000", "0.123", "1.2e-4", "1.2e+4", "-3.14"]);
});
