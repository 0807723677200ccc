//! Errors of segmentation and tracking: wrong lengths and settings out of range, with the small checks that raise them.

use thiserror::Error;

/// An error of segmentation or tracking; the message names the argument and what it must be.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PointsError {
    /// A slice has the wrong length.
    #[error(
        "`{field}` holds {got} values, but {want} are needed ({shape}); pass slices that describe the same Gaussians"
    )]
    Length {
        /// Name of the argument.
        field: &'static str,
        /// Values it holds.
        got: usize,
        /// Values needed.
        want: usize,
        /// Its expected shape, such as `[N, 3]`.
        shape: &'static str,
    },
    /// A setting is out of range.
    #[error("`{field}` is {value}, but must be {want}")]
    Setting {
        /// Name of the setting.
        field: &'static str,
        /// The value given.
        value: String,
        /// What it must be.
        want: &'static str,
    },
    /// An index of a segment points outside the scene.
    #[error("`{field}` names Gaussian {index}, but there are only {count}; was the segment made for another model?")]
    Index {
        /// Name of the argument.
        field: &'static str,
        /// The index given.
        index: u32,
        /// Number of Gaussians in the scene.
        count: usize,
    },
    /// Points are too far apart for the radius used.
    #[error(
        "points spread over {extent} scene units cannot be joined at a radius of {radius}; drop the outliers first"
    )]
    Spread {
        /// Longest side of the bounding box.
        extent: f64,
        /// Radius asked for.
        radius: f64,
    },
    /// The caller asked to stop.
    #[error("stopped")]
    Stopped,
    /// Density clustering rejected its input.
    #[error("density clustering of {samples} sampled features failed: {reason}")]
    Clustering {
        /// Features sampled.
        samples: usize,
        /// The reason given by the clustering.
        reason: String,
    },
}

/// Checks a slice's length.
///
/// # Errors
/// [`PointsError::Length`].
pub fn check_len(field: &'static str, got: usize, want: usize, shape: &'static str) -> Result<(), PointsError> {
    if got == want { Ok(()) } else { Err(PointsError::Length { field, got, want, shape }) }
}

/// Checks that a slice holds whole rows of `row` values and returns the number of rows.
///
/// # Errors
/// [`PointsError::Length`].
pub fn rows(field: &'static str, got: usize, row: usize, shape: &'static str) -> Result<usize, PointsError> {
    if row == 0 {
        return Err(PointsError::Setting { field, value: "0 columns wide".into(), want: "at least 1 column wide" });
    }
    let count = got / row;
    check_len(field, got, if got.is_multiple_of(row) { got } else { (count + 1) * row }, shape)?;
    Ok(count)
}

/// Checks that a length or radius is positive and finite.
///
/// # Errors
/// If it is not.
pub fn check_positive(field: &'static str, value: f32) -> Result<(), PointsError> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(PointsError::Setting { field, value: value.to_string(), want: "a finite number above 0" })
    }
}
