//! What a picture is compared with: a second one from the same camera, or an image of the dataset.

use super::protocol::View;
use schemars::JsonSchema;
use serde::Deserialize;

/// Which of the two pictures of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The picture.
    Picture,
    /// The one beside it, of the same run.
    Beside,
    /// The one beside it, of the other run with this number.
    OfRun(usize),
}

impl Side {
    /// Returns 0 for the picture, 1 for the one beside it.
    pub fn index(self) -> usize {
        usize::from(self != Self::Picture)
    }

    /// Returns the number of the other run, if it shows one.
    pub fn run(self) -> Option<usize> {
        match self {
            Self::OfRun(run) => Some(run),
            Self::Picture | Self::Beside => None,
        }
    }
}

/// What a picture is compared with.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, JsonSchema)]
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
    /// Another run at the same time.
    Run {
        /// Its number among those that the viewer was started with, from 0.
        run: usize,
    },
}

impl Compare {
    /// Returns which picture is drawn beside the first.
    pub fn side(&self) -> Side {
        match *self {
            Self::Run { run } => Side::OfRun(run),
            Self::Image { .. } | Self::Plain | Self::Time { .. } => Side::Beside,
        }
    }

    /// Refuses what cannot be drawn, where `runs` is the number of other runs.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn check(&self, runs: usize) -> Result<(), String> {
        match self {
            Self::Run { run } if *run >= runs => {
                Err(format!("compare: this viewer was started with {runs} other runs, see --with"))
            }
            Self::Time { time } if !(0.0..=1.0).contains(time) => {
                Err("compare: the time must be between 0 and 1".into())
            }
            _ => Ok(()),
        }
    }

    /// Returns the view beside `view`, if one is to be drawn; its colours have the same scale, `range`.
    pub fn other(&self, view: &View, range: Option<[f32; 2]>) -> Option<View> {
        let same = View { range: view.range.or(range), ..view.clone() };
        match *self {
            Self::Image { .. } => None,
            Self::Run { .. } => Some(same),
            Self::Plain => Some(View { edits: false, ..same }),
            Self::Time { time } => Some(View { time, ..same }),
        }
    }
}
