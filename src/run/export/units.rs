//! Units of exported Gaussians: the scene's coordinates, or those of the data.

use crate::data::Calibration;
use crate::data::calibration::PhysicalSpace;
use crate::model::HostGaussians;
use crate::run::RunError;
use serde::Serialize;
use std::ops::RangeInclusive;

/// Coordinates that the Gaussians of a file have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ExportUnits {
    /// Those of the scene, centred and scaled.
    #[default]
    Scene,
    /// Those of the data.
    Physical,
}

/// Moves Gaussians from the scene to the physical `space` of its data. Axes are the same, so nothing is turned.
///
/// # Errors
/// If files with this `extension`, which can hold these natural logarithms of sizes, cannot hold those there.
pub(super) fn to_physical(
    gaussians: &mut HostGaussians,
    space: &PhysicalSpace,
    holds: &RangeInclusive<f32>,
    extension: &str,
) -> Result<(), RunError> {
    for mean in gaussians.means.chunks_exact_mut(3) {
        let at = space.position([mean[0], mean[1], mean[2]].map(f64::from));
        mean.copy_from_slice(&at.map(|v| v as f32));
    }
    let (by, mut misfit) = (space.scale.ln(), None);
    for v in &mut gaussians.log_scales {
        let scene = std::mem::replace(v, (f64::from(*v) + by) as f32);
        // what does not fit in scene units either is rounded in both
        misfit = misfit.or((holds.contains(&scene) && !holds.contains(v)).then_some(*v));
    }
    let Some(v) = misfit else { return Ok(()) };
    let name = extension.to_uppercase();
    Err(RunError::input(format!(
        "--units physical: a standard deviation of {:e} {} is beyond what {name} can hold; write .ply, or scene units",
        v.exp(),
        space.unit_name()
    )))
}

/// Returns what a reader of a file must know of its coordinates and time, as lines of a name and a value.
pub(super) fn comments(calibration: &Calibration, units: ExportUnits, time: f64) -> Vec<String> {
    let mut lines = vec![format!(
        "coordinates {}",
        match units {
            ExportUnits::Scene => "scene",
            ExportUnits::Physical => "physical",
        }
    )];
    match &calibration.space {
        None => lines.push("physical unknown".to_owned()),
        Some(space) => {
            let [x, y, z] = space.centre;
            lines.push("physical = centre + scale * scene".to_owned());
            lines.push(format!("centre {x} {y} {z}"));
            lines.push(format!("scale {}", space.scale));
            lines.extend(space.unit.iter().map(|unit| format!("length_unit {unit}")));
            lines.extend(space.axes.iter().map(|axes| format!("axes {axes}")));
        }
    }
    lines.push(format!("time {time}"));
    if let Some(known) = &calibration.time {
        lines.push(format!("physical_time {}", known.time(time)));
        lines.extend(known.unit.iter().map(|unit| format!("time_unit {unit}")));
    }
    // a unit is free text
    lines.iter().map(|line| line.split(char::is_control).collect::<Vec<_>>().join(" ")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::calibration::PhysicalTime;
    use crate::user_error::UserError;

    fn space(scale: f64) -> PhysicalSpace {
        PhysicalSpace { centre: [1000.0, -5.0, 3.5], scale, unit: Some("mm".into()), axes: None }
    }

    #[test]
    fn gaussians_are_moved_and_enlarged() {
        let mut one = HostGaussians::zeros(1, 1);
        (one.means, one.log_scales) = (vec![0.25, -0.5, 1.0], vec![-3.0, -2.0, 0.0]);
        to_physical(&mut one, &space(72.0), &(f32::MIN..=f32::MAX), "ply").unwrap();
        assert_eq!(one.means, [1018.0, -41.0, 75.5]);
        for (v, scene) in one.log_scales.iter().zip([-3.0f32, -2.0, 0.0]) {
            assert!((v.exp() / (72.0 * scene.exp()) - 1.0).abs() < 1e-5, "{v}");
        }
        let error = to_physical(&mut one, &space(1e6), &(-10.0..=5.9375), "spz").unwrap_err();
        assert!(error.is_input() && error.to_string().contains("beyond what SPZ can hold"), "{error}");
    }

    #[test]
    fn comments_say_how_to_convert() {
        let time = PhysicalTime { start: 100.0, end: 200.0, unit: Some("s".into()) };
        let known = Calibration { space: Some(space(72.5)), time: Some(time) };
        assert_eq!(
            comments(&known, ExportUnits::Scene, 0.25),
            [
                "coordinates scene",
                "physical = centre + scale * scene",
                "centre 1000 -5 3.5",
                "scale 72.5",
                "length_unit mm",
                "time 0.25",
                "physical_time 125",
                "time_unit s"
            ]
        );
        assert_eq!(
            comments(&Calibration::default(), ExportUnits::Scene, 0.5),
            ["coordinates scene", "physical unknown", "time 0.5"]
        );
        let odd = PhysicalSpace { unit: Some("m\nend_header".into()), ..space(1.0) };
        let lines = comments(&Calibration { space: Some(odd), time: None }, ExportUnits::Physical, 0.0);
        assert!(lines.contains(&"length_unit m end_header".to_owned()), "{lines:?}");
    }
}
