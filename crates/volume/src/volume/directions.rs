//! Which way the index axes of a grid point in physical space.

use crate::data::calibration::AxisConvention;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Largest cosine between two axes that are taken as perpendicular: a voxel in a thousand.
const SHEAR: f64 = 1e-3;
/// Directions whose components are this close to 0 and 1 are taken as exactly along the axes of space when data are
/// drawn: files store them in single precision. Over a thousand voxels this is a tenth of one.
const ALONG: f64 = 1e-4;

/// Unit vectors of the index axes x, y, z of a grid in physical space, perpendicular to each other to a thousandth. They
/// may be permuted, point backwards (also an odd number of them) or lie obliquely.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "[[f64; 3]; 3]", into = "[[f64; 3]; 3]")]
pub struct Directions([[f64; 3]; 3]);

impl Directions {
    /// The index axes are those of space.
    pub const ALIGNED: Self = Self([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);

    /// The directions and the lengths of the vectors that lead from a voxel to the next along x, y, z.
    ///
    /// # Errors
    /// What is wrong: a vector of no finite length, or two that are not perpendicular.
    pub fn of_steps(steps: [[f64; 3]; 3]) -> Result<(Self, [f64; 3]), String> {
        const NAMES: [char; 3] = ['x', 'y', 'z'];
        let steps = steps.map(DVec3::from_array);
        let lengths = steps.map(DVec3::length);
        for a in 0..3 {
            if !(lengths[a] > 0.0 && lengths[a].is_finite()) {
                return Err(format!("the vector {} of axis {} has no direction", steps[a], NAMES[a]));
            }
        }
        let units: [DVec3; 3] = std::array::from_fn(|a| steps[a] / lengths[a]);
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            let cosine = units[a].dot(units[b]);
            if cosine.abs() > SHEAR {
                let degrees = cosine.clamp(-1.0, 1.0).acos().to_degrees();
                return Err(format!("the axes {} and {} are {degrees:.2} degrees apart, not 90", NAMES[a], NAMES[b]));
            }
        }
        // -0 is 0
        Ok((Self(units.map(|unit| unit.to_array().map(|v| v + 0.0))), lengths))
    }

    /// The unit vector of an index axis.
    pub fn axis(&self, axis: usize) -> DVec3 {
        DVec3::from_array(self.0[axis])
    }

    /// The unit vectors as columns.
    pub fn matrix(&self) -> DMat3 {
        DMat3::from_cols_array_2d(&self.0)
    }

    /// Whether the index axes are exactly those of space.
    pub fn is_aligned(&self) -> bool {
        *self == Self::ALIGNED
    }

    /// The nearest orthogonal matrix with the unit vectors as columns, which is a permutation with signs if they lie
    /// along the axes of space; `None` if it is the identity, so that nothing needs to be multiplied.
    pub fn turn(&self) -> Option<DMat3> {
        let rounded = self.0.map(|unit| unit.map(|v| v.round() + 0.0));
        let off = self.0.iter().flatten().zip(rounded.iter().flatten()).map(|(v, r)| (v - r).abs());
        let turn = if off.fold(0.0, f64::max) <= ALONG {
            DMat3::from_cols_array_2d(&rounded)
        } else {
            let x = self.axis(0).normalize();
            let y = (self.axis(1) - x.dot(self.axis(1)) * x).normalize();
            let z = x.cross(y);
            DMat3::from_cols(x, y, if z.dot(self.axis(2)) < 0.0 { -z } else { z })
        };
        (turn != DMat3::IDENTITY).then_some(turn)
    }

    /// The same directions in another convention of the axes of space.
    #[must_use]
    pub fn converted(self, from: AxisConvention, to: AxisConvention) -> Self {
        Self(self.0.map(|unit| from.convert(unit, to)))
    }

    /// Whether these are the directions of `other` to `tolerance` in each component.
    pub fn agree(&self, other: &Self, tolerance: f64) -> bool {
        self.0.iter().flatten().zip(other.0.iter().flatten()).all(|(a, b)| (a - b).abs() <= tolerance)
    }

    /// The directions in letters: where the index axes lead, such as `RAS` or `LPS`, or `+x-y+z` where the axes of space
    /// have no anatomical meaning; with the largest angle to them if they lie obliquely.
    pub fn code(&self, axes: Option<AxisConvention>) -> String {
        let mut code = String::new();
        let mut cosine = 1.0f64;
        for unit in self.0 {
            let along = (0..3).max_by(|a, b| unit[*a].abs().total_cmp(&unit[*b].abs())).unwrap_or(0);
            cosine = cosine.min(unit[along].abs());
            let forwards = unit[along] > 0.0;
            match axes {
                Some(axes) => code.push(axes.letter(along, forwards)),
                None => code.extend([if forwards { '+' } else { '-' }, ['x', 'y', 'z'][along]]),
            }
        }
        let degrees = cosine.acos().to_degrees();
        if degrees >= 0.05 { format!("{code}, oblique by {degrees:.1} degrees") } else { code }
    }
}

impl fmt::Display for Directions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.0;
        write!(f, "{x:?} {y:?} {z:?}")
    }
}

impl TryFrom<[[f64; 3]; 3]> for Directions {
    type Error = String;

    fn try_from(units: [[f64; 3]; 3]) -> Result<Self, String> {
        let (_, lengths) = Self::of_steps(units)?;
        match lengths.iter().all(|l| (l - 1.0).abs() <= SHEAR) {
            // as they are, not divided by their rounded lengths
            true => Ok(Self(units)),
            false => Err(format!("{units:?} are not unit vectors")),
        }
    }
}

impl From<Directions> for [[f64; 3]; 3] {
    fn from(directions: Directions) -> Self {
        directions.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_exact_and_what_has_no_direction_is_refused() {
        let (directions, lengths) =
            Directions::of_steps([[0.0, -0.7, 0.0], [1e-30, 0.0, 0.0], [0.0, 0.0, 3e29]]).unwrap();
        assert_eq!(lengths, [0.7, 1e-30, 3e29]);
        assert_eq!(directions.0, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
        let bad = |steps| Directions::of_steps(steps).unwrap_err();
        assert!(bad([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).contains("axis y"));
        assert!(bad([[f64::NAN, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).contains("axis x"));
        let sheared = bad([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.1, 0.0, 1.0]]);
        assert!(sheared.contains("x and z are 84.29 degrees apart"), "{sheared}");
        assert!(serde_json::from_str::<Directions>("[[2,0,0],[0,1,0],[0,0,1]]").is_err());
        let there = serde_json::to_string(&directions).unwrap();
        assert_eq!(serde_json::from_str::<Directions>(&there).unwrap(), directions);
    }

    #[test]
    fn turns_are_orthogonal_and_exact_along_the_axes() {
        assert_eq!(Directions::ALIGNED.turn(), None);
        let noisy = Directions::of_steps([[1.0, 3e-5, 0.0], [-3e-5, 1.0, 1e-7], [0.0, 0.0, 1.0]]).unwrap().0;
        assert_eq!(noisy.turn(), None, "single precision");
        assert!(!noisy.is_aligned());
        let flipped = Directions::of_steps([[0.0, 0.0, -2.0], [3.0, 1e-6, 0.0], [0.0, 1.0, 0.0]]).unwrap().0;
        assert_eq!(flipped.turn(), Some(DMat3::from_cols(-DVec3::Z, DVec3::X, DVec3::Y)));
        for handed in [1.0, -1.0] {
            let (s, c) = 0.3f64.sin_cos();
            let steps = [[c, s, 0.0], [-s, c, 5e-4], [0.0, 0.0, handed]];
            let turn = Directions::of_steps(steps).unwrap().0.turn().unwrap();
            assert!((turn.transpose() * turn).abs_diff_eq(DMat3::IDENTITY, 1e-14));
            assert!((turn.determinant() - handed).abs() < 1e-12);
            assert!(turn.x_axis.abs_diff_eq(DVec3::new(c, s, 0.0), 1e-3));
        }
    }

    #[test]
    fn codes_name_where_axes_lead() {
        use AxisConvention::{LeftPosteriorSuperior as Lps, RightAnteriorSuperior as Ras};
        let d = |steps| Directions::of_steps(steps).unwrap().0;
        assert_eq!([Some(Ras), Some(Lps), None].map(|c| Directions::ALIGNED.code(c)), ["RAS", "LPS", "+x+y+z"]);
        let las = d([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        assert_eq!((las.code(Some(Ras)), las.converted(Ras, Lps).code(Some(Lps))), ("LAS".into(), "LAS".into()));
        let turned = d([[0.0, 0.0, -1.0], [0.2f64.cos(), 0.2f64.sin(), 0.0], [-0.2f64.sin(), 0.2f64.cos(), 0.0]]);
        assert_eq!(turned.code(Some(Ras)), "IRA, oblique by 11.5 degrees");
        assert_eq!(turned.code(None), "-z+x+y, oblique by 11.5 degrees");
    }
}
