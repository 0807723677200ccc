//! The methods compared.

use serde::Serialize;
use std::fmt;
use std::str::FromStr;

/// A way to turn a click into a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum SelectionMethod {
    /// All Gaussians of the clicked colour.
    #[serde(rename = "coarse")]
    Coarse,
    /// The affinity field alone, trained on masks of the whole scene.
    #[serde(rename = "fine")]
    Fine,
    /// The affinity field within the clicked colour.
    #[serde(rename = "coarse+fine")]
    CoarseFine,
    /// Affinity features of each Gaussian, gated by scale.
    #[serde(rename = "saga")]
    Saga,
    /// Votes of the masks, without training.
    #[serde(rename = "sagd")]
    Sagd,
}

impl SelectionMethod {
    /// All methods, in the order of the tables.
    pub const ALL: [Self; 5] = [Self::Sagd, Self::Saga, Self::Coarse, Self::Fine, Self::CoarseFine];

    /// Returns its name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Coarse => "coarse",
            Self::Fine => "fine",
            Self::CoarseFine => "coarse+fine",
            Self::Saga => "saga",
            Self::Sagd => "sagd",
        }
    }
}

impl fmt::Display for SelectionMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for SelectionMethod {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|m| m.name() == text);
        found.ok_or_else(|| format!("\"{text}\" is not a method; available: {}", Self::ALL.map(Self::name).join(", ")))
    }
}
