//! `segment.*`: how a scene becomes segments, by colours, masks and clicks.
//!
//! Every option between a colour or a click and a segment is a key here, with its default, its unit or range, and what
//! the default rests on: the page of `benches/results` that is named, or the scenes that it was set on. A rule that can be
//! left out has a switch of its own.
//!
//! An option is one line: its name, type, default and range, in the section of the rule that reads it. The rule gets it
//! from the [`SegmentConfig`] that is passed down to it, so that a new option needs its line and its reader, nothing else.
//!
//! Segmentation reads the resolved section of the opened run, `run.config.segment`. It is layered as the rest of the
//! configuration (defaults, files, environment, `--set`) when the run is trained, and again when it is segmented, with
//! the run's own values at the bottom: `volseggs segment` and `volseggs eval --segments` take `--config` and `--set
//! segment.KEY=VALUE`. Nothing here changes a step of training. Such keys may therefore differ when a run resumes, and a
//! sweep keeps them out of what a run is recognised by: variants that differ in nothing else share the trained run and
//! are measured apart.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt::Display;
use std::ops::RangeInclusive;

/// Name of this section of the configuration. Training does not read it, and runs of sweeps lack it.
pub const SECTION: &str = "segment";

/// Declares a section: options as `name: type = default, range;`, the range only for numbers, inclusive.
macro_rules! section {
    ($(#[$about:meta])* $name:ident, $path:literal {
        $($(#[$doc:meta])* $option:ident: $kind:ty = $default:expr $(, $range:expr)?;)*
    }) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name {
            $($(#[$doc])* pub $option: $kind,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($option: $default,)* }
            }
        }

        impl $name {
            /// Checks that each number is in its range.
            ///
            /// # Errors
            /// The first one that is not.
            pub fn check(&self) -> Result<(), crate::config::types::segment::OutOfRange> {
                use crate::config::types::segment::{Numbers, within};
                $($(within(concat!($path, ".", stringify!($option)), self.$option.numbers(), &$range)?;)?)*
                Ok(())
            }
        }
    };
}

mod clicks;
mod colours;
mod layers;
mod masks;

pub use clicks::{ClickConfig, LevelsConfig, NecksConfig, NestedConfig, ObjectsConfig, PropagateConfig};
pub use colours::{ColourConfig, ColourSpace, GroupsConfig, MaterialConfig};
pub use layers::{ContactsConfig, LayersConfig, PiecesConfig};
pub use masks::{AffinityConfig, MaskScale, MasksConfig};

/// `segment.*`, see the [module](self).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SegmentConfig {
    /// Segments by colour.
    pub colour: ColourConfig,
    /// The colour of a Gaussian's material.
    pub material: MaterialConfig,
    /// Groups of materials.
    pub groups: GroupsConfig,
    /// When two Gaussians are in contact.
    pub contacts: ContactsConfig,
    /// Surface layers.
    pub layers: LayersConfig,
    /// Connected pieces and strays.
    pub pieces: PiecesConfig,
    /// Masks of rendered views.
    pub masks: MasksConfig,
    /// Training of the affinity field.
    pub affinity: AffinityConfig,
    /// What is under a click.
    pub click: ClickConfig,
    /// The levels of parts and wholes at a click.
    pub levels: LevelsConfig,
    /// Touching objects of one colour, told apart by their affinity.
    pub objects: ObjectsConfig,
    /// Touching objects of one colour, told apart by the necks between them.
    pub necks: NecksConfig,
    /// Objects of several colours.
    pub nested: NestedConfig,
    /// Selections at other times.
    pub propagate: PropagateConfig,
}

impl SegmentConfig {
    /// Checks that each number is in its range.
    ///
    /// # Errors
    /// The first one that is not.
    pub fn check(&self) -> Result<(), OutOfRange> {
        self.colour.check()?;
        self.material.check()?;
        self.groups.check()?;
        self.contacts.check()?;
        self.layers.check()?;
        self.pieces.check()?;
        self.masks.check()?;
        self.affinity.check()?;
        self.click.check()?;
        self.levels.check()?;
        self.objects.check()?;
        self.necks.check()?;
        self.nested.check()?;
        self.propagate.check()
    }

    /// Whether every option has its default.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// An option that is out of range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("segment.{key} = {value}: must be from {low} to {high}")]
pub struct OutOfRange {
    /// Its key, without the section `segment`.
    pub key: &'static str,
    /// Its value.
    pub value: String,
    /// The lowest value allowed.
    pub low: String,
    /// The highest value allowed.
    pub high: String,
}

/// One number or several.
trait Numbers {
    type Number;

    fn numbers(&self) -> &[Self::Number];
}

macro_rules! numbers {
    ($($kind:ty),*) => {
        $(impl Numbers for $kind {
            type Number = Self;

            fn numbers(&self) -> &[Self] {
                std::slice::from_ref(self)
            }
        })*
    };
}

numbers!(f32, f64, u32, u64, usize);

impl<T> Numbers for Vec<T> {
    type Number = T;

    fn numbers(&self) -> &[T] {
        self
    }
}

/// Checks that there are `values` and all are in `range`.
fn within<T: PartialOrd + Display>(
    key: &'static str,
    values: &[T],
    range: &RangeInclusive<T>,
) -> Result<(), OutOfRange> {
    let wrong =
        |value: String| OutOfRange { key, value, low: range.start().to_string(), high: range.end().to_string() };
    if values.is_empty() {
        return Err(wrong("[]".to_owned()));
    }
    // a NaN is in no range
    values.iter().find(|value| !range.contains(value)).map_or(Ok(()), |value| Err(wrong(value.to_string())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PRESETS;
    use crate::config::layers::Layers;
    use crate::config::types::Config;

    #[test]
    fn defaults_are_in_range_and_what_is_not_is_named() {
        SegmentConfig::default().check().unwrap();
        assert!(SegmentConfig::default().is_default());
        let check = |set: &str| {
            let found = Layers::new(PRESETS).sets([set]).resolve::<Config>().unwrap().value.segment;
            found.check().unwrap_err().to_string()
        };
        assert_eq!(check("segment.layers.edge=3"), "segment.layers.edge = 3: must be from 0 to 1");
        assert_eq!(check("segment.layers.edge=nan"), "segment.layers.edge = NaN: must be from 0 to 1");
        assert!(check("segment.levels.scales=[0.5, 1.5]").contains("segment.levels.scales = 1.5"));
        assert!(check("segment.levels.scales=[]").contains("segment.levels.scales = []"));
    }

    #[test]
    fn one_key_leaves_the_others_and_shows_in_short() {
        let found = Layers::new(PRESETS).sets(["segment.groups.pass=0.25"]).resolve::<Config>().unwrap();
        let expected = GroupsConfig { pass: 0.25, ..GroupsConfig::default() };
        assert_eq!(found.value.segment, SegmentConfig { groups: expected, ..SegmentConfig::default() });
        let shown = found.show();
        assert!(shown.contains("segment.groups.pass = 0.25  # --set"), "{shown}");
        assert!(shown.contains("segment.groups.similarity = 0.17  # default"), "{shown}");
    }
}
