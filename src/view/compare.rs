//! What a picture is compared with: a second one from the same camera, or the dataset's image of it.

use super::protocol::View;
use serde::Deserialize;

/// With what.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(tag = "with", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Compare {
    /// The dataset's image of this test view, from 0.
    Image {
        /// Its number.
        view: usize,
    },
    /// The same without edits.
    Plain,
    /// The same at another time.
    Time {
        /// In [0, 1].
        time: f64,
    },
}

impl Compare {
    /// Refuses what cannot be drawn.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::Time { time } if !(0.0..=1.0).contains(time) => Err("compare: a time between 0 and 1".into()),
            _ => Ok(()),
        }
    }

    /// The picture beside that of `view`, if one is to be drawn; its colours have the same scale, `range`.
    #[must_use]
    pub fn other(&self, view: &View, range: Option<[f32; 2]>) -> Option<View> {
        let same = View { range: view.range.or(range), ..view.clone() };
        match *self {
            Self::Image { .. } => None,
            Self::Plain => Some(View { edits: false, ..same }),
            Self::Time { time } => Some(View { time, ..same }),
        }
    }
}
