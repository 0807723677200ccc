// Long work: starting it, its progress, and how it ended.
import { $, app, duration, on, say, value } from "./state.js";
import { ask, hear, start } from "./socket.js";
import { chosen } from "./segments.js";
import { plot } from "./plot.js";

let job = null; // the last reported state of a job

const number = (id) => ($(id).value === "" ? null : Math.round(value(id)));

const masks = () => ({ kind: "masks", segments: [...app.checked], source: $("mask-source").value, views: number("mask-views"), size: null, replace: $("mask-replace").checked });
const fine = () => ({ kind: "fine", steps: number("fine-steps") ?? 5000 });
function split() {
  const segments = chosen();
  if (segments.length > 1) return say("Check exactly one segment to split.", true);
  return segments.length ? { kind: "split", segment: segments[0], scale: value("split-scale"), clusters: number("split-parts"), replace: $("split-replace").checked } : null;
}
function track() {
  const segments = chosen();
  return segments.length ? { kind: "track", segments, group: $("track-name").value.trim() || null, frames: number("track-times") ?? 51 } : null;
}
const exported = () => ({ kind: "export", format: $("export-format").value, segments: [...app.checked], edited: $("edits-on").checked, time: value("when"), frames: number("export-times") });

for (const [id, task] of Object.entries({ masks, fine, split, track, export: exported })) $(`${id}-start`).onclick = () => start(task());
$("job-cancel").onclick = () => job && ask({ type: "cancel", job: job.number }).catch((message) => say(message, true));
$("job-close").onclick = () => {
  $("job").hidden = true;
  $("part-work").querySelector("summary").focus();
};

function figures() {
  if (!job.end) {
    const counted = job.all ? `${job.done} of ${job.all} ${job.unit}, ` : "";
    const left = job.left === null ? "" : `, ${duration(job.left)} left`;
    const loss = job.losses.length ? `, loss ${job.losses.at(-1)[1].toFixed(4)}` : "";
    return `${counted}${duration(job.seconds)}${left}${loss}`;
  }
  if (job.end === "stopped") return `cancelled after ${duration(job.seconds)}; nothing was changed`;
  return job.end.done ? `${job.end.done} (${duration(job.seconds)})` : job.end.failed;
}

const OLD = 2; // seconds after which ended work is no longer announced in a newly opened window

function last() {
  $("job-last").textContent = `Last, ${duration(job.ago)} ago, ${job.title}: ${figures()}`;
  $("job-last").hidden = false;
}

hear("job", (message) => {
  const begins = job?.number !== message.number;
  // repeated for a window that has reconnected to the viewer
  if (!begins && job.end) return;
  job = message;
  if (begins && job.end && job.ago > OLD) return last();
  $("job-last").hidden = true;
  $("job").hidden = false;
  $("job").dataset.end = !job.end ? "" : job.end === "stopped" ? "stopped" : Object.keys(job.end)[0];
  $("job-title").textContent = job.stopping && !job.end ? `${job.title}: stopping` : job.title;
  $("job-progress").hidden = Boolean(job.end);
  $("job-cancel").hidden = Boolean(job.end);
  $("job-close").hidden = !job.end;
  $("job-cancel").disabled = job.stopping || app.welcome?.read_only;
  if (job.all) Object.assign($("job-progress"), { max: job.all, value: job.done });
  else $("job-progress").removeAttribute("value");
  $("job-figures").textContent = figures();
  $("job-loss").toggleAttribute("hidden", job.losses.length < 2);
  plot($("job-loss"), [{ points: job.losses }]);
  // announced to screen readers once, not at every step
  if (begins && !job.end) $("job-news").textContent = `${job.title}: started`;
  if (job.end) $("job-news").textContent = `${job.title}: ${figures()}`;
});
on("welcome", ({ read_only: still }) => {
  $("work").disabled = still;
  // a restarted viewer does not know this job; one that does reports it at once
  if (job && !job.end) $("job").hidden = true;
});
