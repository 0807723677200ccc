//! A scalar field and its labels on a regular grid, in memory: one time step. Files are read in `formats`, images made
//! in `raycast`.

/// The geometry of a regular grid; x is the fastest axis in memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Number of voxels along x, y, z; each at least 1.
    pub dims: [usize; 3],
    /// Distance between voxel centres along x, y, z, in the file's units; finite and positive.
    pub spacing: [f64; 3],
    /// Position of the centre of the first voxel, in the file's units.
    pub origin: [f64; 3],
}

impl Grid {
    /// A grid of unit spacing at the origin.
    #[must_use]
    pub fn unit(dims: [usize; 3]) -> Self {
        Self { dims, spacing: [1.0; 3], origin: [0.0; 3] }
    }

    /// Number of voxels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.dims.iter().product()
    }

    /// True if an axis has no voxel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Distance between the first and the last voxel centre along x, y, z.
    #[must_use]
    pub fn size(&self) -> [f64; 3] {
        std::array::from_fn(|a| self.dims[a].saturating_sub(1) as f64 * self.spacing[a])
    }
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
pub struct Labels {
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
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

impl ScalarType {
    /// Bytes of one value.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// The name in sidecars and messages: `u8`, `i16`, `f32`, ...
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }
}
