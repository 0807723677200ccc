//! Tasks that can be started from the page: the work of slow commands, done by the same functions on the same files.

use super::board::Reporter;
use super::export::Export;
use crate::config::types::segment::AffinityConfig;
use crate::export::exporters::{self, Exporter};
use crate::name::Name;
use crate::run::cameras::check_lens;
use crate::run::follow::{FollowProgress, FollowRequest, SHEET, TrackedTimes, follow};
use crate::run::masks::{MaskPlan, MaskRequest, make};
use crate::run::segments::{RunSegments, write_picture};
use crate::run::split::{SplitOptions, sheet, split};
use crate::run::{OpenRun, RunError, affinity};
use crate::segment::masks::registry::{ChosenSource, SourceOptions, SourceViews};
use crate::segment::masks::source::MASK_SOURCES;
use crate::track::report::{PictureOptions, SHEET_CELL};
use schemars::JsonSchema;
use serde::Deserialize;
use std::fmt;
use std::ops::RangeInclusive;

/// Maximum number of views of masks, parts or times that a client may request.
const MAX_COUNT: usize = 1000;
/// Numbers of steps that a client may request.
const STEPS: RangeInclusive<usize> = 1..=1_000_000;
/// Minimum alpha of a pixel of the mask whose area is tracked.
const MASK_ALPHA: f32 = 0.5;

/// Long work.
#[derive(Clone, Debug, Deserialize, PartialEq, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Task {
    /// Masks of segments, as `segment masks`.
    Masks {
        /// Which segments; all that are not part of another if empty.
        segments: Vec<String>,
        /// Name of the source of masks: one that needs no other program or download.
        source: String,
        /// Number of views; the command's default if not given.
        views: Option<usize>,
        /// Width of the pictures in pixels; that of the training images if not given.
        size: Option<u32>,
        /// Whether existing masks are replaced.
        replace: bool,
    },
    /// The affinity field, as `segment fine`.
    Fine {
        /// Number of steps.
        steps: usize,
    },
    /// Parts of a segment, as `segment split`.
    Split {
        /// The segment.
        segment: String,
        /// Mask scale in [0, 1].
        scale: f32,
        /// Number of parts; as many as are found if not given.
        clusters: Option<usize>,
        /// Whether segments picked in the parts of an earlier split may be removed.
        replace: bool,
    },
    /// Segments through time, as `track`.
    Track {
        /// Which segments.
        segments: Vec<String>,
        /// Name under which they are tracked as one.
        #[schemars(with = "Option<String>")]
        group: Option<Name>,
        /// Number of times, evenly spaced over [0, 1].
        frames: usize,
    },
    /// Files for other programs, as `export`, in the run folder.
    Export {
        /// Their format, by the extension of the files.
        #[serde(deserialize_with = "exporters::deserialize")]
        #[schemars(with = "String")]
        format: &'static Exporter,
        /// Segments to write; all if empty.
        segments: Vec<String>,
        /// Whether the edits apply.
        edited: bool,
        /// Time in [0, 1].
        time: f64,
        /// Number of times, evenly spaced over [0, 1], instead of the one.
        frames: Option<usize>,
    },
}

/// Returns the names of the sources of masks that need no other program or download.
pub fn mask_sources() -> Vec<String> {
    MASK_SOURCES.all().into_iter().filter(|(_, kind)| kind.reads().is_empty()).map(|(name, _)| name).collect()
}

/// Describes the task in words.
impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |names: &[String]| if names.is_empty() { "all segments".to_owned() } else { names.join(", ") };
        match self {
            Self::Masks { segments, .. } => write!(f, "masks of {}", list(segments)),
            Self::Fine { steps } => write!(f, "training the affinity field, {steps} steps"),
            Self::Split { segment, .. } => write!(f, "split of {segment}"),
            Self::Track { segments, group, .. } => match group {
                Some(group) => write!(f, "track of {} as {group}", list(segments)),
                None => write!(f, "track of {}", list(segments)),
            },
            Self::Export { format, segments, .. } if segments.is_empty() => {
                write!(f, "export to {}", format.extension)
            }
            Self::Export { format, segments, .. } => {
                write!(f, "export of {} to {}", list(segments), format.extension)
            }
        }
    }
}

impl Task {
    /// Refuses numbers out of range; names are checked where they are looked up.
    ///
    /// # Errors
    /// What is wrong.
    pub fn check(&self) -> Result<(), String> {
        let within = |what: &str, value: usize, range: RangeInclusive<usize>| {
            if range.contains(&value) {
                Ok(())
            } else {
                Err(format!("{what}: must be between {} and {}", range.start(), range.end()))
            }
        };
        let unit = |what: &str, value: f64| {
            if (0.0..=1.0).contains(&value) { Ok(()) } else { Err(format!("{what}: must be between 0 and 1")) }
        };
        match self {
            Self::Masks { source, views, size, .. } => {
                if !mask_sources().contains(source) {
                    return Err(format!("source: \"{source}\" is not one of {}", mask_sources().join(", ")));
                }
                let labelled = MASK_SOURCES.get(source).is_ok_and(|kind| kind.views() == SourceViews::Labelled);
                if labelled && size.is_some() {
                    return Err("size: label images keep their own size; leave it out".into());
                }
                views.map_or(Ok(()), |n| within("views", n, 1..=MAX_COUNT))?;
                size.map_or(Ok(()), |n| within("size", n as usize, 16..=4096))
            }
            Self::Fine { steps } => within("steps", *steps, STEPS),
            Self::Split { scale, clusters, .. } => {
                unit("scale", f64::from(*scale))?;
                clusters.map_or(Ok(()), |n| within("parts", n, 1..=MAX_COUNT))
            }
            Self::Track { segments, frames, .. } => {
                if segments.is_empty() {
                    return Err("segments: name at least one to track".into());
                }
                within("times", *frames, 2..=MAX_COUNT)
            }
            Self::Export { time, frames, .. } => {
                unit("time", *time)?;
                frames.map_or(Ok(()), |n| within("times", n, 1..=MAX_COUNT))
            }
        }
    }

    /// Carries out the task on a run whose lock is held, and returns a description of what was made. `None` if `report`
    /// stopped it: everything is then as before.
    ///
    /// # Errors
    /// As the functions of [`crate::run`].
    pub fn carry_out(&self, run: &OpenRun, report: &mut Reporter) -> Result<Option<String>, RunError> {
        match self {
            Self::Masks { segments, source, views, size, replace } => {
                let source = &ChosenSource::new(source, SourceOptions::default()).map_err(RunError::input)?;
                let request = MaskRequest { segments, source, views: *views, time: None };
                masks(run, &request, *size, *replace, report)
            }
            Self::Fine { steps } => fine(run, *steps, report),
            Self::Split { segment, scale, clusters, replace } => {
                let (scale, clusters, replace) = (*scale, *clusters, *replace);
                let options = SplitOptions { scale, clusters, seed: 0, replace };
                parts(run, segment, &options, report)
            }
            Self::Track { segments, group, frames } => track(run, segments, group.as_ref(), *frames, report),
            Self::Export { format, segments, edited, time, frames } => {
                let times = match *frames {
                    Some(n) => (0..n).map(|i| i as f64 / (n - 1).max(1) as f64).collect(),
                    None => vec![*time],
                };
                Export { format, segments, edited: *edited, times: &times, many: frames.is_some() }.write(run, report)
            }
        }
    }
}

fn masks(
    run: &OpenRun,
    request: &MaskRequest<'_>,
    size: Option<u32>,
    replace: bool,
    report: &mut Reporter,
) -> Result<Option<String>, RunError> {
    let path = run.paths().masks();
    if path.exists() && !replace {
        let path = path.display();
        return Err(RunError::input(format!(
            "{path}: masks exist already; tick `replace` beside `make masks` to make new ones"
        )));
    }
    let mut around = run.record.surroundings;
    if let Some(size) = size {
        around = around.sized(size);
        check_lens(&format!("size {size}"), around.lens)?;
    }
    let plan = MaskPlan::new(run, &around, request)?;
    let all = plan.pictures();
    let mut done = 0;
    let made = make(run, &plan, || {
        done += 1;
        report.report("pictures", done, all, None)
    })?;
    let note = plan.note.as_ref().map(|note| format!("; {note}")).unwrap_or_default();
    Ok(made.map(|made| {
        let (segments, views) = (plan.groups.len(), plan.shots.len());
        format!("{} masks of {segments} segments in {views} views{note}", made.masks)
    }))
}

fn fine(run: &OpenRun, steps: usize, report: &mut Reporter) -> Result<Option<String>, RunError> {
    let options = AffinityConfig { steps, ..run.config.segment.affinity.clone() };
    let trained = affinity::fit(run, &options, 0, |stage| match stage {
        affinity::AffinityProgress::Read { done, all } => report.report("views", done, all, None),
        affinity::AffinityProgress::Begins { .. } => report.report("steps", 0, steps, None),
        affinity::AffinityProgress::Step { done, loss } => report.report("steps", done, steps, Some(loss)),
    })?;
    Ok(trained.map(|t| format!("the affinity field is trained, loss {:.4}: click to select", t.loss)))
}

fn parts(run: &OpenRun, segment: &str, options: &SplitOptions, report: &Reporter) -> Result<Option<String>, RunError> {
    let mut segments = RunSegments::open(run)?;
    let Some(parts) = split(run, &mut segments, segment, options, &|| report.goes_on())? else {
        return Ok(None);
    };
    segments.save()?;
    let picture = sheet(run, &run.record.surroundings, &parts);
    write_picture(&run.paths().segment_sheet(segment), &picture)?;
    Ok(Some(format!("{segment} has {} parts", parts.names.len())))
}

fn track(
    run: &OpenRun,
    segments: &[String],
    group: Option<&Name>,
    frames: usize,
    report: &mut Reporter,
) -> Result<Option<String>, RunError> {
    let full = run.record.surroundings;
    let width = full.lens.width.min(SHEET_CELL);
    let camera = full.sized(width).orbit(SHEET).swap_remove(0);
    let times = TrackedTimes::Even { from: 0.0, to: 1.0, frames };
    let asked = format!("{frames} times");
    let pictures = PictureOptions { keep: false, mask_alpha: MASK_ALPHA };
    let request = FollowRequest {
        segments,
        group,
        times: &times,
        asked: &asked,
        camera: &camera,
        edited: true,
        pictures,
        out: None,
    };
    let mut done = [0, 0];
    let found = follow(run, &request, |stage| {
        let (k, unit) = match stage {
            FollowProgress::Followed => (0, "times tracked"),
            FollowProgress::Drawn => (1, "times drawn"),
        };
        done[k] += 1;
        report.report(unit, done[k], frames, None)
    })?;
    let folder = run.paths().tracks();
    Ok(found.map(|found| {
        let names: Vec<&str> = found.iter().map(|f| f.name.as_str()).collect();
        format!("tables and pictures of {}: {}", names.join(", "), folder.display())
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_task_is_read_named_and_checked() {
        let read = |text: &str| serde_json::from_str::<Task>(text);
        let masks = |size: &str, views: &str| {
            format!(
                r#"{{"kind":"masks","segments":[],"source":"labels","views":{views},"size":{size},"replace":false}}"#
            )
        };
        let task = read(&masks("null", "5")).unwrap();
        assert_eq!((task.to_string().as_str(), task.check()), ("masks of all segments", Ok(())));
        assert!(read(&masks("64", "5")).unwrap().check().unwrap_err().starts_with("size"));
        assert!(
            read(&masks("null", "0")).unwrap().check().unwrap_err().starts_with("views: must be between 1 and 1000")
        );
        let sam = masks("null", "5").replace("labels", "sam");
        assert!(read(&sam).unwrap().check().unwrap_err().contains("is not one of regions, labels"));
        let group = r#"{"kind":"track","segments":["a","b"],"group":"pair","frames":51}"#;
        assert_eq!(read(group).unwrap().to_string(), "track of a, b as pair");
        for bad in [
            r#"{"kind":"track","segments":[],"group":null,"frames":51}"#,
            r#"{"kind":"track","segments":["a"],"group":null,"frames":1}"#,
            r#"{"kind":"fine","steps":0}"#,
            r#"{"kind":"split","segment":"a","scale":1.5,"clusters":null,"replace":false}"#,
            r#"{"kind":"export","format":"ply","segments":[],"edited":true,"time":2.0,"frames":null}"#,
        ] {
            assert!(read(bad).unwrap().check().is_err(), "{bad}");
        }
        for bad in [
            r#"{"kind":"track","segments":["a"],"group":"../a","frames":51}"#,
            r#"{"kind":"export","format":"ply","segments":[],"edited":true,"time":0.5,"frames":null,"out":"/tmp/x"}"#,
        ] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }
}
