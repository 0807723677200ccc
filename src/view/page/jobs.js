// Long work: starting it, its progress, and how it ended.
import { $, say, value } from "./dom.js";
import { plot } from "./plot.js";
import { chosen } from "./segments.js";
import { attempt, hear, start } from "./socket.js";
import { app, on } from "./state.js";
import { duration } from "./units.js";
/** @import { JobState, Task } from "./protocol" */
/** @import { Valued } from "./dom.js" */

/** @type {JobState | null} */
let job = null; // the last reported state of a job

/** @param {Valued} id */
const number = (id) => ($(id).value === "" ? null : Math.round(value(id)));

/** @template T @param {{ value: string }} select whose options are of this type @returns {T} */
const option = (select) => /** @type {any} */ (select.value);

/** @type {Record<"masks" | "fine" | "split" | "track" | "export", () => Task | null>} */
const tasks = {
  masks: () => ({
    kind: "masks", segments: [...app.checked], source: option($("mask-source")), views: number("mask-views"), size: null,
    replace: $("mask-replace").checked,
  }),
  fine: () => ({ kind: "fine", steps: number("fine-steps") ?? 5000 }),
  split() {
    const segments = chosen();
    if (segments.length > 1) say("Check exactly one segment to split.", true);
    if (segments.length !== 1) return null;
    const [scale, clusters, replace] = [value("split-scale"), number("split-parts"), $("split-replace").checked];
    return { kind: "split", segment: segments[0], scale, clusters, replace };
  },
  track() {
    const segments = chosen();
    if (!segments.length) return null;
    return { kind: "track", segments, group: $("track-name").value.trim() || null, frames: number("track-times") ?? 51 };
  },
  export: () => ({
    kind: "export", format: $("export-format").value, segments: [...app.checked], edited: $("edits-on").checked,
    time: value("when"), frames: number("export-times"),
  }),
};
for (const kind of /** @type {const} */ (["masks", "fine", "split", "track", "export"])) {
  $(`${kind}-start`).onclick = () => start(tasks[kind]());
}
$("job-cancel").onclick = () => job && attempt({ type: "cancel", job: job.number });
$("job-close").onclick = () => {
  $("job").hidden = true;
  $("part-work").querySelector("summary")?.focus();
};

/** @param {JobState} job */
function figures({ end, all, done, unit, left, losses, seconds }) {
  if (end === null) {
    const counted = all ? `${done} of ${all} ${unit}, ` : "";
    const remaining = left === null ? "" : `, ${duration(left)} left`;
    const loss = losses.length ? `, loss ${losses[losses.length - 1][1].toFixed(4)}` : "";
    return `${counted}${duration(seconds)}${remaining}${loss}`;
  }
  if (end === "stopped") return `cancelled after ${duration(seconds)}; nothing was changed`;
  return "done" in end ? `${end.done} (${duration(seconds)})` : end.failed;
}

const OLD = 2; // seconds after which ended work is no longer announced in a newly opened window

hear("job", (message) => {
  const begins = job?.number !== message.number;
  // repeated for a window that has reconnected to the viewer
  if (!begins && job?.end) return;
  job = message;
  const { title, end, losses } = message;
  if (begins && end && message.ago !== null && message.ago > OLD) {
    $("job-last").textContent = `Last, ${duration(message.ago)} ago, ${title}: ${figures(message)}`;
    $("job-last").hidden = false;
    return;
  }
  $("job-last").hidden = true;
  $("job").hidden = false;
  $("job").dataset.end = !end ? "" : end === "stopped" ? "stopped" : Object.keys(end)[0];
  $("job-title").textContent = message.stopping && !end ? `${title}: stopping` : title;
  $("job-progress").hidden = Boolean(end);
  $("job-cancel").hidden = Boolean(end);
  $("job-close").hidden = !end;
  $("job-cancel").disabled = message.stopping || Boolean(app.welcome?.read_only);
  if (message.all) Object.assign($("job-progress"), { max: message.all, value: message.done });
  else $("job-progress").removeAttribute("value");
  $("job-figures").textContent = figures(message);
  $("job-loss").toggleAttribute("hidden", losses.length < 2);
  plot($("job-loss"), [{ points: losses }]);
  // announced to screen readers once, not at every step
  if (begins && !end) $("job-news").textContent = `${title}: started`;
  if (end) $("job-news").textContent = `${title}: ${figures(message)}`;
});
on("welcome", ({ read_only: readOnly }) => {
  $("work").disabled = readOnly;
  // a restarted viewer does not know this job; one that does reports it at once
  if (job && !job.end) $("job").hidden = true;
});
