// When which time or camera is due while the scene or a path is played. A slow machine skips some and keeps the speed.

/** Step between times, which are on a grid, so that the second loop finds the cached Gaussians of the first. */
export const STEP = 0.01;

/**
 * The time of the scene that is due.
 * @param {{ from: number, at: number }} playing since `from`, in milliseconds, when the time was `at`
 * @param {number} now in milliseconds
 * @param {number} seconds that the whole time takes, at least 1
 * @param {boolean} loop whether it begins again
 * @returns {number | null} null at the end
 */
export function timeDue({ from, at }, now, seconds, loop) {
  const t = at + (now - from) / 1000 / Math.max(1, seconds);
  return t >= 1 && !loop ? null : Math.round((t % 1) / STEP) * STEP;
}

/**
 * Number of the camera of a path that is due.
 * @param {number} from when the path began, in milliseconds
 * @param {number} now in milliseconds
 * @param {number} rate cameras per second
 */
export const cameraDue = (from, now, rate) => Math.round(((now - from) / 1000) * rate);

/**
 * Seconds of a keyframe that is added to others.
 * @param {readonly { seconds: number }[]} keys
 * @param {number} gap seconds after the last one
 */
export const secondsAfter = (keys, gap) => {
  const last = keys.at(-1);
  return last ? last.seconds + Math.max(0.1, gap) : 0;
};
