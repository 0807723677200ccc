//! Location of each plane, line and time tensor of the feature field in the three flat parameter buffers. Sizes and
//! offsets only: no sampling and no parameter values.

/// Axes of the three spatial planes xy, xz, yz as (fast axis, slow axis).
pub const PLANE_AXES: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// The axis of the line that multiplies each plane: xy with z, xz with y, yz with x.
pub const PLANE_LINE: [usize; 3] = [2, 1, 0];

/// One resolution level of the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LevelShape {
    /// Grid nodes along x, y and z; each at least 1.
    pub resolution: [usize; 3],
}

/// Sizes of the whole field. All parameters of one kind lie in one flat buffer, channel last:
///
/// - planes: for each level `[ny, nx, R]` (xy), `[nz, nx, R]` (xz), `[nz, ny, R]` (yz)
/// - lines: for each level `[nx, R]`, `[ny, R]`, `[nz, R]`
/// - times: for each level `[T, R]`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldShape {
    /// Levels, in feature order.
    pub levels: Vec<LevelShape>,
    /// Time knots `T` of every level; at least 1.
    pub time_knots: usize,
    /// Channels `R` of every tensor; at least 1. Multiples of 16 use whole vectors on every processor;
    /// others may fall back to one channel at a time.
    pub channels: usize,
}

/// A tensor `[height, width, R]` inside a flat buffer. Lines and times have width 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TensorSpan {
    /// First element in the flat buffer.
    pub offset: usize,
    /// Nodes along the slow axis.
    pub height: usize,
    /// Nodes along the fast spatial axis.
    pub width: usize,
}

/// Why a [`FieldShape`] cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FieldShapeError {
    /// The level list is empty.
    #[error("FieldShape.levels is empty; give at least one level")]
    NoLevels,
    /// A level has an axis without nodes.
    #[error("FieldShape.levels[{level}].resolution[{axis}] is 0; every axis needs at least one node")]
    EmptyAxis {
        /// Index of the level.
        level: usize,
        /// Axis: 0 x, 1 y, 2 z.
        axis: usize,
    },
    /// No time knots.
    #[error("FieldShape.time_knots is 0; give at least one knot")]
    NoTimeKnots,
    /// No channels.
    #[error("FieldShape.channels is 0; give at least one channel")]
    NoChannels,
}

impl FieldShape {
    /// Checks that every extent is at least 1.
    ///
    /// # Errors
    /// Names the first extent that is 0.
    pub fn validate(&self) -> Result<(), FieldShapeError> {
        if self.levels.is_empty() {
            return Err(FieldShapeError::NoLevels);
        }
        for (level, shape) in self.levels.iter().enumerate() {
            if let Some(axis) = shape.resolution.iter().position(|&n| n == 0) {
                return Err(FieldShapeError::EmptyAxis { level, axis });
            }
        }
        if self.time_knots == 0 {
            return Err(FieldShapeError::NoTimeKnots);
        }
        if self.channels == 0 {
            return Err(FieldShapeError::NoChannels);
        }
        Ok(())
    }

    /// Checks that the shape is valid and that planes, lines and times have these lengths.
    ///
    /// # Panics
    /// If not.
    pub(crate) fn check(&self, [planes, lines, times]: [usize; 3]) {
        if let Err(error) = self.validate() {
            panic!("{error}");
        }
        assert_eq!(planes, self.planes_len(), "planes");
        assert_eq!(lines, self.lines_len(), "lines");
        assert_eq!(times, self.times_len(), "times");
    }

    /// Features per point: `levels * R`.
    pub fn features_len(&self) -> usize {
        self.levels.len() * self.channels
    }

    /// Length of the flat plane buffer.
    pub fn planes_len(&self) -> usize {
        self.span_len(&self.plane_spans())
    }

    /// Length of the flat line buffer.
    pub fn lines_len(&self) -> usize {
        self.span_len(&self.line_spans())
    }

    /// Length of the flat time buffer.
    pub fn times_len(&self) -> usize {
        self.levels.len() * self.time_knots * self.channels
    }

    /// Returns the plane tensors in buffer order: for each level xy, xz, yz.
    pub fn plane_spans(&self) -> Vec<TensorSpan> {
        self.spans(|level| PLANE_AXES.map(|(fast, slow)| (level.resolution[slow], level.resolution[fast])))
    }

    /// Returns the line tensors in buffer order: for each level x, y, z.
    pub fn line_spans(&self) -> Vec<TensorSpan> {
        self.spans(|level| level.resolution.map(|n| (n, 1)))
    }

    /// Returns the time tensors in buffer order, one for each level.
    pub fn time_spans(&self) -> Vec<TensorSpan> {
        self.spans(|_| [(self.time_knots, 1)])
    }

    fn spans<const N: usize>(&self, extents: impl Fn(&LevelShape) -> [(usize, usize); N]) -> Vec<TensorSpan> {
        let mut offset = 0;
        let mut spans = Vec::with_capacity(N * self.levels.len());
        for level in &self.levels {
            for (height, width) in extents(level) {
                spans.push(TensorSpan { offset, height, width });
                offset += height * width * self.channels;
            }
        }
        spans
    }

    fn span_len(&self, spans: &[TensorSpan]) -> usize {
        spans.iter().map(|s| s.height * s.width).sum::<usize>() * self.channels
    }
}
