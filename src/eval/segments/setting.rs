//! Settings of each method: the one fixed in advance, and the tries of the oracle, the same number for each method.

use super::method::SelectionMethod;
use crate::config::types::SegmentConfig;
use crate::config::types::segment::ColourSpace;
use crate::segment::baselines::sagd::{MaskChoice, SagdOptions};
use crate::segment::pick::{Granularity, PickOptions, SagaPick};
use std::fmt;

/// Number of the oracle's tries for every method.
pub const TRIES: usize = 12;

/// Scales that fields and SAGA are tried at, ...
const SCALES: [f32; 3] = [0.1, 0.5, 0.9];
/// ... each with these cosines.
const COSINES: [f32; 4] = [0.5, 0.8, 0.9, 0.97];
/// Fractions of the votes that SAGD is tried with, for each choice of a mask.
const AGREEMENTS: [f32; 4] = [0.5, 0.6, 0.7, 0.8];
/// Numbers of colours that `coarse` is tried with in each space, besides the requested or suggested one.
const COLOURS: [usize; 5] = [2, 3, 4, 6, 8];
/// Number of colours, none of these, that replaces the one of them that equals the requested number.
const SPARE: usize = 5;

/// How colours are found: what the oracle tries of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Colouring {
    /// Number of colours; 0 suggests it from the data.
    pub clusters: usize,
    /// Space in which colours are compared.
    pub space: ColourSpace,
}

impl Colouring {
    /// Returns that of a configuration.
    pub fn fixed(config: &SegmentConfig) -> Self {
        Self { clusters: config.colour.clusters, space: config.colour.space }
    }

    /// Returns a configuration with this one.
    pub fn within(self, config: &SegmentConfig) -> SegmentConfig {
        let mut config = config.clone();
        (config.colour.clusters, config.colour.space) = (self.clusters, self.space);
        config
    }
}

/// A setting of a method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MethodSetting {
    /// How colours are found.
    Coarse(Colouring),
    /// An affinity field, of the scene or within a colour.
    Field(PickOptions),
    /// SAGA.
    Saga(SagaPick),
    /// SAGD.
    Sagd(SagdOptions),
}

impl MethodSetting {
    /// Returns the setting of a method that nobody has tuned: the default of `segment coarse` and `segment pick`; for
    /// SAGA, what corresponds to it; for SAGD, the published one.
    pub fn fixed(method: SelectionMethod, config: &SegmentConfig) -> Self {
        match method {
            SelectionMethod::Coarse => Self::Coarse(Colouring::fixed(config)),
            SelectionMethod::Fine | SelectionMethod::CoarseFine => Self::Field(PickOptions::default()),
            SelectionMethod::Saga => Self::Saga(SagaPick::default()),
            SelectionMethod::Sagd => Self::Sagd(SagdOptions::default()),
        }
    }

    /// Returns what the oracle may choose from, including the fixed setting. Fields: the fixed setting, and eleven
    /// combinations of three scales with four cosines; SAGA: all twelve combinations; SAGD: three choices of a mask
    /// with four fractions of the votes; `coarse`: six numbers of colours in two spaces. No two are equal.
    pub fn tries(method: SelectionMethod, config: &SegmentConfig) -> [Self; TRIES] {
        let coarse = Colouring::fixed(config);
        std::array::from_fn(|i| match method {
            SelectionMethod::Coarse => {
                let clusters = match i / 2 {
                    0 => coarse.clusters,
                    n if coarse.clusters == COLOURS[n - 1] => SPARE,
                    n => COLOURS[n - 1],
                };
                let other = if coarse.space == ColourSpace::Rgb { ColourSpace::Material } else { ColourSpace::Rgb };
                let space = if i % 2 == 0 { coarse.space } else { other };
                Self::Coarse(Colouring { clusters, space })
            }
            // the levels that the masks show replace the smallest scale with the lowest cosine
            SelectionMethod::Fine | SelectionMethod::CoarseFine if i == 0 => Self::Field(PickOptions::default()),
            SelectionMethod::Fine | SelectionMethod::CoarseFine => {
                let (scale, threshold) = by_hand(i);
                Self::Field(PickOptions { meaning: Granularity::By { scale, threshold }, ..PickOptions::default() })
            }
            SelectionMethod::Saga => {
                let (scale, cosine) = by_hand(i);
                Self::Saga(SagaPick::like(scale, cosine))
            }
            SelectionMethod::Sagd => {
                let choice = [MaskChoice::Largest, MaskChoice::Middle, MaskChoice::Smallest][i / 4];
                Self::Sagd(SagdOptions { choice, agreement: AGREEMENTS[i % 4], ..SagdOptions::default() })
            }
        })
    }
}

/// Returns the scale and cosine of try `i` of a field.
fn by_hand(i: usize) -> (f32, f32) {
    (SCALES[i / 4], COSINES[i % 4])
}

impl fmt::Display for MethodSetting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Coarse(c) => {
                let space = match c.space {
                    ColourSpace::Material => "by material",
                    ColourSpace::Rgb => "in RGB",
                    ColourSpace::Lab => "in Lab",
                };
                match c.clusters {
                    0 => write!(f, "suggested number of colours {space}"),
                    k => write!(f, "{k} colours {space}"),
                }
            }
            Self::Field(p) => match p.meaning {
                Granularity::Likeliest => f.write_str("the likeliest level"),
                Granularity::Level(level) => write!(f, "level {}", level + 1),
                Granularity::OfKind(kind) => write!(f, "level {}", kind.name()),
                Granularity::By { scale, threshold } => write!(f, "scale {scale}, cosine {threshold}"),
            },
            Self::Saga(p) => write!(f, "scale {}, similarity {:.3}", p.scale, p.threshold),
            Self::Sagd(s) => {
                let mask = match s.choice {
                    MaskChoice::Largest => "largest",
                    MaskChoice::Middle => "middle",
                    MaskChoice::Smallest => "smallest",
                };
                write!(f, "{mask} mask, more than {} of the votes", s.agreement)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tries_of_every_method_are_distinct_and_include_the_fixed_setting() {
        for clusters in [0, SPARE].into_iter().chain(COLOURS) {
            let mut config = SegmentConfig::default();
            config.colour.clusters = clusters;
            for method in SelectionMethod::ALL {
                let tries = MethodSetting::tries(method, &config);
                for (i, one) in tries.iter().enumerate() {
                    assert!(!tries[..i].contains(one), "{method}, {clusters}: {one}");
                }
                assert!(tries.contains(&MethodSetting::fixed(method, &config)), "{method}, {clusters}");
            }
        }
    }

    #[test]
    fn colours_are_tried_with_the_suggested_number_and_five_more() {
        let numbers = |clusters| {
            let mut config = SegmentConfig::default();
            config.colour.clusters = clusters;
            MethodSetting::tries(SelectionMethod::Coarse, &config).map(|setting| match setting {
                MethodSetting::Coarse(options) => options.clusters,
                other => panic!("{other}"),
            })
        };
        let twice = |all: [usize; 6]| all.into_iter().flat_map(|k| [k, k]).collect::<Vec<_>>();
        assert_eq!(numbers(0).to_vec(), twice([0, 2, 3, 4, 6, 8]));
        assert_eq!(numbers(3).to_vec(), twice([3, 2, 5, 4, 6, 8]));
    }
}
