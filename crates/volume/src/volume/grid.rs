//! A scalar field and its labels on a regular grid, in memory: one time step. Files are read in `formats`, images made
//! in `raycast`.

use super::directions::Directions;
use crate::data::calibration::AxisConvention;
use glam::{DMat3, DVec3};

/// The geometry of a regular grid; the index axis x is the fastest in memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Number of voxels along the index axes x, y, z; each at least 1.
    pub dims: [usize; 3],
    /// Distance between voxel centres along the index axes, in the file's units; finite and positive.
    pub spacing: [f64; 3],
    /// Physical position of the centre of the first voxel, in the file's units.
    pub origin: [f64; 3],
    /// Unit vectors of the index axes in physical space.
    pub directions: Directions,
}

impl Grid {
    /// A grid whose index axes are those of physical space.
    pub const fn aligned(dims: [usize; 3], spacing: [f64; 3], origin: [f64; 3]) -> Self {
        Self { dims, spacing, origin, directions: Directions::ALIGNED }
    }

    /// A grid of unit spacing at the origin.
    pub fn unit(dims: [usize; 3]) -> Self {
        Self::aligned(dims, [1.0; 3], [0.0; 3])
    }

    /// Whether positions are voxel indices, as in files that say nothing of space.
    pub fn is_unit(&self) -> bool {
        *self == Self::unit(self.dims)
    }

    /// The vectors from a voxel to the next along the index axes, as columns.
    pub fn steps(&self) -> DMat3 {
        self.directions.matrix() * DMat3::from_diagonal(DVec3::from_array(self.spacing))
    }

    /// The physical position of voxel coordinates, in which voxel `i` has its centre at `i`.
    pub fn position(&self, index: DVec3) -> DVec3 {
        DVec3::from_array(self.origin) + self.steps() * index
    }

    /// The voxel coordinates of a physical position.
    pub fn index(&self, position: DVec3) -> DVec3 {
        self.steps().inverse() * (position - DVec3::from_array(self.origin))
    }

    /// The physical position of the middle of the box between the outermost voxel centres.
    pub fn centre(&self) -> DVec3 {
        DVec3::from_array(self.origin) + self.directions.matrix() * (0.5 * DVec3::from_array(self.size()))
    }

    /// The same voxels at the same places, described in another convention of the axes of space.
    #[must_use]
    pub fn converted(self, from: AxisConvention, to: AxisConvention) -> Self {
        let directions = self.directions.converted(from, to);
        Self { origin: from.convert(self.origin, to), directions, ..self }
    }

    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.dims.iter().product()
    }

    /// True if an axis has no voxel.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Distance between the first and the last voxel centre along the index axes.
    pub fn size(&self) -> [f64; 3] {
        std::array::from_fn(|a| self.dims[a].saturating_sub(1) as f64 * self.spacing[a])
    }
}

/// The voxels that share a face with voxel `index` of a grid with these numbers of voxels along x, y, z; x is the
/// fastest in memory.
pub fn face_neighbours(index: usize, [x, y, z]: [usize; 3]) -> impl Iterator<Item = usize> {
    let [i, j, k] = [index % x, index / x % y, index / (x * y)];
    let sides = [
        (i > 0).then(|| index - 1),
        (i + 1 < x).then(|| index + 1),
        (j > 0).then(|| index - x),
        (j + 1 < y).then(|| index + x),
        (k > 0).then(|| index - x * y),
        (k + 1 < z).then(|| index + x * y),
    ];
    sides.into_iter().flatten()
}

/// A scalar field at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Where the values are.
    pub grid: Grid,
    /// The values `[z, y, x]`, x fastest, in data units, all finite.
    pub values: Vec<f32>,
}

/// Which segment each voxel belongs to, at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeLabels {
    /// Where the labels are.
    pub grid: Grid,
    /// Segment ids `[z, y, x]`, x fastest; 0 is no segment.
    pub ids: Vec<u16>,
}

/// How a file stores one value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScalarType {
    /// 8-bit unsigned.
    U8,
    /// 8-bit signed.
    I8,
    /// 16-bit unsigned.
    U16,
    /// 16-bit signed.
    I16,
    /// 32-bit unsigned.
    U32,
    /// 32-bit signed.
    I32,
    /// 64-bit unsigned.
    U64,
    /// 64-bit signed.
    I64,
    /// Half precision.
    F16,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

impl ScalarType {
    /// Bytes of one value.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Whether its values are whole numbers.
    pub fn is_whole(self) -> bool {
        !matches!(self, Self::F16 | Self::F32 | Self::F64)
    }

    /// Whether some of its values have more digits than single precision holds.
    pub fn is_wide(self) -> bool {
        self.bytes() == 8 || matches!(self, Self::U32 | Self::I32)
    }

    /// The name in sidecars and messages: `u8`, `i16`, `f32`, ...
    pub fn name(self) -> &'static str {
        SCALAR_NAMES[self as usize].1
    }

    /// The type of a name: that of [`ScalarType::name`], or another that files use, such as `unsigned char` or `float`.
    pub fn of_name(name: &str) -> Option<Self> {
        let known = SCALAR_NAMES.iter().find(|(_, own, others)| *own == name || others.contains(&name));
        known.map(|(scalar, ..)| *scalar)
    }
}

/// Every type in the order of the enum, with its name and the other names that files use for it, in lower case.
const SCALAR_NAMES: [(ScalarType, &str, &[&str]); 11] = [
    (ScalarType::U8, "u8", &["uchar", "unsigned char", "uint8", "uint8_t", "byte"]),
    (ScalarType::I8, "i8", &["char", "signed char", "int8", "int8_t"]),
    (ScalarType::U16, "u16", &["ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"]),
    (ScalarType::I16, "i16", &["short", "short int", "signed short", "signed short int", "int16", "int16_t"]),
    (ScalarType::U32, "u32", &["uint", "unsigned", "unsigned int", "uint32", "uint32_t"]),
    (ScalarType::I32, "i32", &["int", "signed int", "int32", "int32_t"]),
    (ScalarType::U64, "u64", &["ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"]),
    (
        ScalarType::I64,
        "i64",
        &["longlong", "long long", "long long int", "signed long long", "signed long long int", "int64", "int64_t"],
    ),
    (ScalarType::F16, "f16", &["half", "float16"]),
    (ScalarType::F32, "f32", &["float", "float32", "single"]),
    (ScalarType::F64, "f64", &["double", "float64"]),
];

#[cfg(test)]
mod tests {
    use super::*;
    use AxisConvention::{LeftPosteriorSuperior as Lps, RightAnteriorSuperior as Ras};
    use glam::DQuat;
    use proptest::prelude::*;

    #[test]
    fn scalar_types_are_found_by_their_names() {
        for (i, (scalar, name, others)) in SCALAR_NAMES.into_iter().enumerate() {
            assert_eq!((scalar as usize, scalar.name(), ScalarType::of_name(name)), (i, name, Some(scalar)));
            assert!(others.iter().all(|other| ScalarType::of_name(other) == Some(scalar)), "{name}");
        }
        assert_eq!(ScalarType::of_name("long double"), None);
    }

    proptest! {
        #[test]
        fn indices_go_to_positions_and_back(
            axis in prop::array::uniform3(-1.0..1.0f64), angle in 0.0..7.0f64, mirror: bool,
            spacing in prop::array::uniform3(1e-3..1e3f64), origin in prop::array::uniform3(-1e4..1e4f64),
            index in prop::array::uniform3(-10.0..500.0f64),
        ) {
            let turn = DMat3::from_quat(DQuat::from_axis_angle(DVec3::from_array(axis).normalize_or(DVec3::X), angle));
            let mut steps = turn.to_cols_array_2d();
            if mirror {
                steps[1] = steps[1].map(|v| -v);
            }
            let (directions, _) = Directions::of_steps(steps).unwrap();
            let grid = Grid { dims: [5, 7, 3], spacing, origin, directions };
            let index = DVec3::from_array(index);
            let place = grid.position(index);
            prop_assert!((grid.index(place) - index).length() < 1e-6, "{}", grid.index(place));
            let middle = grid.position(DVec3::new(2.0, 3.0, 1.0));
            prop_assert!((middle - grid.centre()).length() < 1e-9 * (1.0 + middle.length()));
            let other = grid.converted(Ras, Lps);
            let [x, y, z] = place.to_array();
            prop_assert!((other.position(index) - DVec3::new(-x, -y, z)).length() < 1e-9 * (1.0 + place.length()));
            prop_assert_eq!(other.converted(Lps, Ras), grid);
        }
    }
}
