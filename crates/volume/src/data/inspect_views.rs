//! The checks of times, lens and camera layout, from the JSON alone. Used by `inspect` alone.

use super::camera::{Camera, look_at_point};
use super::inspect::{DatasetReport, SplitFacts};
use super::lens::check_lens;
use super::scan::SplitScan;
use super::transforms::FrameRecord;
use std::path::Path;

/// Checks whether the times are evenly spread, and over all of [0, 1].
pub(super) fn times(report: &mut DatasetReport, facts: &mut SplitFacts, records: &[(usize, &FrameRecord)]) {
    let mut all: Vec<f64> = records.iter().map(|(_, r)| r.time).collect();
    all.sort_by(f64::total_cmp);
    let counts: Vec<usize> = all.chunk_by(|a, b| a == b).map(<[f64]>::len).collect();
    all.dedup();
    let (Some(first), Some(last)) = (all.first().copied(), all.last().copied()) else {
        return;
    };
    facts.times = all.len();
    facts.time_range = Some([first, last]);
    let (fewest, most) = (counts.iter().min().copied(), counts.iter().max().copied());
    facts.views_per_time = fewest.zip(most).map(|(a, b)| [a, b]);
    let name = facts.name.clone();
    let mut detail = format!("{} times from {first:.4} to {last:.4}", all.len());
    let mut even = true;
    if all.len() > 2 {
        let mean = (last - first) / (all.len() - 1) as f64;
        let largest = all.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
        facts.time_step_ratio = Some(largest / mean);
        even = largest <= 2.0 * mean;
        detail += &format!(", the largest step is {:.2} times the mean", largest / mean);
    }
    if let Some([fewest, most]) = facts.views_per_time {
        detail += &format!(", {fewest} to {most} views each");
    }
    report.check(&name, "times", even, detail);
    let whole = all.len() < 2 || (first < 0.05 && last > 0.95);
    let detail = if whole { "the times span 0 to 1" } else { "the times do not cover all of [0, 1]; rescale them" };
    report.check(&name, "time range", whole, detail);
}

/// Checks whether the lens is sane, and whether the cameras look at one point.
pub(super) fn cameras(
    report: &mut DatasetReport,
    facts: &mut SplitFacts,
    json: &Path,
    scan: &SplitScan,
    records: &[(usize, &FrameRecord)],
) {
    let [w, h] = facts.resolution.unwrap_or([1, 1]);
    let cameras: Vec<Camera> = records.iter().map(|(_, r)| scan.intrinsics.camera(w, h, r.camera_to_world)).collect();
    let Some(one) = cameras.first() else { return };
    let name = facts.name.clone();
    if facts.resolution.is_some() {
        facts.focal = Some([one.fx, one.fy]);
        facts.principal_point = Some([one.cx, one.cy]);
        facts.fov_x_degrees = Some(one.fov_x().to_degrees());
        let ratio = one.fx / one.fy;
        let detail = format!(
            "{:.3} degrees, focal length {:.2} x {:.2}, principal point ({:.2}, {:.2}) pixels",
            one.fov_x().to_degrees(),
            one.fx,
            one.fy,
            one.cx,
            one.cy
        );
        report.check(&name, "lens", (0.9..1.1).contains(&ratio), detail);
        let aspect = check_lens(json, &scan.intrinsics, (w, h));
        report.check_list(
            &name,
            "aspect",
            aspect.err().iter().map(ToString::to_string).collect(),
            "that of the images",
        );
    }
    let found = look_at_point(cameras.iter());
    let centre = found.map_or(glam::DVec3::ZERO, |(p, _)| p);
    let distances = || cameras.iter().map(|c| c.position().distance(centre));
    let (near, far) = (distances().fold(f64::INFINITY, f64::min), distances().fold(0.0, f64::max));
    facts.camera_radius = Some([near, far]);
    facts.look_at = found.map(|(p, _)| p.to_array());
    facts.look_at_error = found.map(|(_, e)| e);
    match found {
        Some((p, error)) => {
            let detail = format!(
                "the cameras look at ({:.4}, {:.4}, {:.4}) to within {error:.1e}, from {near:.4} to {far:.4} away",
                p.x, p.y, p.z
            );
            let behind = cameras.iter().filter(|c| c.forward().dot(p - c.position()) <= 0.0).count();
            let ok = behind == 0;
            let more = if ok { String::new() } else { format!("; {behind} look away from it: check the -z axis") };
            report.check(&name, "camera layout", ok, detail + &more);
        }
        None => report.check(&name, "camera layout", cameras.len() < 2, "the optical axes do not meet"),
    }
}
