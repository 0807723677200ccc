//! Sizes of the decoder and of its parameter buffers. No parameter values and no arithmetic on them.

/// Sizes of the decoder: `F` inputs, `W` hidden units in the trunk and in each of `H` heads, `C` outputs.
/// Head `k` owns the next `head_sizes[k]` output columns; one head with all columns is the shared variant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DecoderShape {
    /// Features per row, `F`; at least 1.
    pub inputs: usize,
    /// Hidden units `W` of the trunk and of each head; at least 1. Multiples of 16 (of 32 with 512-bit
    /// vectors) waste no arithmetic.
    pub width: usize,
    /// Output columns of each head; each at least 1.
    pub head_sizes: Vec<usize>,
}

/// Why a [`DecoderShape`] cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecoderShapeError {
    /// No input features.
    #[error("DecoderShape.inputs is 0; give at least one feature")]
    NoInputs,
    /// No hidden units.
    #[error("DecoderShape.width is 0; give at least one hidden unit")]
    NoWidth,
    /// The list of heads is empty.
    #[error("DecoderShape.head_sizes is empty; give at least one head")]
    NoHeads,
    /// A head without outputs.
    #[error("DecoderShape.head_sizes[{head}] is 0; every head needs at least one output column")]
    EmptyHead {
        /// Index of the head.
        head: usize,
    },
}

impl DecoderShape {
    /// Checks that every extent is at least 1.
    ///
    /// # Errors
    /// Names the first extent that is 0.
    pub fn validate(&self) -> Result<(), DecoderShapeError> {
        if self.inputs == 0 {
            return Err(DecoderShapeError::NoInputs);
        }
        if self.width == 0 {
            return Err(DecoderShapeError::NoWidth);
        }
        if self.head_sizes.is_empty() {
            return Err(DecoderShapeError::NoHeads);
        }
        match self.head_sizes.iter().position(|&n| n == 0) {
            Some(head) => Err(DecoderShapeError::EmptyHead { head }),
            None => Ok(()),
        }
    }

    /// Number of heads `H`.
    pub fn heads(&self) -> usize {
        self.head_sizes.len()
    }

    /// Number of output columns `C` of all heads.
    pub fn outputs(&self) -> usize {
        self.head_sizes.iter().sum()
    }

    /// Length of `w0` `[F, W]`.
    pub fn w0_len(&self) -> usize {
        self.inputs * self.width
    }

    /// Length of `b0` `[W]`.
    pub fn b0_len(&self) -> usize {
        self.width
    }

    /// Length of `w1` `[W, H * W]`.
    pub fn w1_len(&self) -> usize {
        self.width * self.heads() * self.width
    }

    /// Length of `b1` `[H * W]`.
    pub fn b1_len(&self) -> usize {
        self.heads() * self.width
    }

    /// Length of `w2` `[W, C]`.
    pub fn w2_len(&self) -> usize {
        self.width * self.outputs()
    }

    /// Length of `b2` `[C]`.
    pub fn b2_len(&self) -> usize {
        self.outputs()
    }

    /// First output column and number of columns of each head.
    pub(super) fn head_columns(&self) -> impl Iterator<Item = (usize, usize)> {
        self.head_sizes.iter().scan(0, |next, &size| {
            let first = *next;
            *next += size;
            Some((first, size))
        })
    }
}
