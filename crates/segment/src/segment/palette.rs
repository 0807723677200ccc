//! Names and hex strings for cluster colours, and distinct colours, for legends and segment lists. No clustering
//! happens here.

use super::colour::rgb_to_lab;
use serde::{Deserialize, Serialize};

/// One cluster's colour with its name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PaletteEntry {
    /// Name, different from every other name of the palette: `red`, `light blue`, `grey-2`.
    pub name: String,
    /// `#rrggbb`.
    pub hex: String,
    /// The colour, clamped to `[0, 1]`.
    pub rgb: [f32; 3],
}

const NAMED: [(&str, u32); 34] = [
    ("black", 0x000000),
    ("dark grey", 0x404040),
    ("grey", 0x808080),
    ("light grey", 0xc0c0c0),
    ("white", 0xffffff),
    ("red", 0xe6191e),
    ("dark red", 0x7f0a0c),
    ("light red", 0xf48080),
    ("pink", 0xffb6c8),
    ("magenta", 0xe619c8),
    ("dark magenta", 0x7f0a6e),
    ("purple", 0x8028b4),
    ("dark purple", 0x461464),
    ("light purple", 0xbe96e6),
    ("blue", 0x1946dc),
    ("dark blue", 0x0a1e78),
    ("light blue", 0x8cb4f0),
    ("sky blue", 0x28a0e6),
    ("cyan", 0x19d2d2),
    ("dark cyan", 0x0a6e6e),
    ("light cyan", 0xaaf0f0),
    ("teal", 0x14968c),
    ("green", 0x1eaa28),
    ("dark green", 0x0a5a14),
    ("light green", 0x96e696),
    ("lime", 0x96dc1e),
    ("olive", 0x787814),
    ("yellow", 0xf5e61e),
    ("light yellow", 0xfaf5a0),
    ("gold", 0xd2a014),
    ("orange", 0xf58214),
    ("light orange", 0xfabe82),
    ("brown", 0x82501e),
    ("beige", 0xdcc8aa),
];

/// Number of leading entries of [`NAMED`] that have no hue.
const GREYS: usize = 5;
/// Chroma in CIE Lab from which a hue is visible.
const MIN_HUE_CHROMA: f32 = 10.0;
/// Colours of less chroma have their hue compared as if they had this much.
const COMPARED_CHROMA: f32 = 40.0;
/// Weight of a difference in chroma relative to one in lightness, where a dull colour is named by its hue.
const DULL: f32 = 0.3;

/// Maximum distance, in CIE Lab, of another name from a colour whose own name is taken.
const MAX_NAME_DISTANCE: f32 = 30.0;

/// Names the rows of `colours` `[K, 3]` (sRGB in `[0, 1]`) by the nearest named colour in CIE Lab. Where that is a grey
/// although a hue is visible, as in the dull blue of thin smoke, the nearest in hue and lightness is used.
///
/// A repeated name gets `-2`, `-3`, ... in row order. Values are clamped to `[0, 1]`; a row with a non-finite value is
/// shown black and named `unknown`. Trailing values that do not fill a row are skipped.
pub fn name_colours(colours: &[f32]) -> Vec<PaletteEntry> {
    named(colours, 0.0)
}

/// Like [`name_colours`], but a name that is taken gives way to the next one of a similar colour: a pale and a deep
/// blue are `light blue` and `blue`, and only nearly identical colours get numbers.
pub fn name_materials(colours: &[f32]) -> Vec<PaletteEntry> {
    named(colours, MAX_NAME_DISTANCE)
}

/// Names the rows of `colours`; one whose name is taken gets the nearest free one within `max_distance` of it.
fn named(colours: &[f32], max_distance: f32) -> Vec<PaletteEntry> {
    let table: Vec<[f32; 3]> = NAMED.iter().map(|&(_, code)| rgb_to_lab(unpack(code))).collect();
    let mut used: Vec<(&str, usize)> = Vec::new();
    colours
        .chunks_exact(3)
        .map(|row| {
            let known = row.iter().all(|v| v.is_finite());
            let rgb = [0, 1, 2].map(|i| if known { row[i].clamp(0.0, 1.0) } else { 0.0 });
            let mut base = if known { nearest(&table, rgb) } else { "unknown" };
            if used.iter().any(|(name, _)| *name == base) {
                let free = |name: &str| used.iter().all(|(other, _)| *other != name);
                base = next_name(&table, base, rgb, max_distance, free).unwrap_or(base);
            }
            let count = match used.iter_mut().find(|(name, _)| *name == base) {
                Some((_, count)) => {
                    *count += 1;
                    *count
                }
                None => {
                    used.push((base, 1));
                    1
                }
            };
            let name = if count == 1 { base.to_owned() } else { format!("{base}-{count}") };
            PaletteEntry { name, hex: hex(rgb), rgb }
        })
        .collect()
}

/// The nearest free name for a colour called `base`, nearer than `max_distance`; greys get the names of greys, others
/// do not.
fn next_name(
    table: &[[f32; 3]],
    base: &str,
    rgb: [f32; 3],
    max_distance: f32,
    free: impl Fn(&str) -> bool,
) -> Option<&'static str> {
    let lab = rgb_to_lab(rgb);
    let grey = NAMED[..GREYS].iter().any(|(name, _)| *name == base);
    let mut best = (max_distance * max_distance, None);
    for (k, ((name, _), entry)) in NAMED.iter().zip(table).enumerate().filter(|(k, _)| (*k < GREYS) == grey) {
        let distance = if k < GREYS { (entry[0] - lab[0]).powi(2) } else { by_hue(*entry, lab) };
        if distance < best.0 && free(name) {
            best = (distance, Some(*name));
        }
    }
    best.1
}

/// Index of the colour nearest to `rgb` (sRGB in `[0, 1]`) in CIE Lab, where the hue of dull colours counts as much as
/// that of others; `None` if there are no colours, or `rgb` is not finite.
pub fn nearest_colour(colours: &[[f32; 3]], rgb: [f32; 3]) -> Option<usize> {
    let lab = rgb_to_lab(rgb.map(|v| v.clamp(0.0, 1.0)));
    let known = !colours.is_empty() && rgb.iter().all(|v| v.is_finite());
    let table: Vec<[f32; 3]> = colours.iter().map(|colour| rgb_to_lab(*colour)).collect();
    known.then(|| index_of_nearest(&table, |entry| by_hue(*entry, lab)))
}

/// `#rrggbb` of an sRGB colour, clamped to `[0, 1]` (NaN counts as 0).
pub fn hex(rgb: [f32; 3]) -> String {
    let [r, g, b] = rgb.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn nearest(table: &[[f32; 3]], rgb: [f32; 3]) -> &'static str {
    let lab = rgb_to_lab(rgb);
    let plain = |entry: &[f32; 3]| (0..3).map(|i| (entry[i] - lab[i]).powi(2)).sum();
    let found = index_of_nearest(table, plain);
    if found >= GREYS || lab[1].hypot(lab[2]) < MIN_HUE_CHROMA {
        return NAMED[found].0;
    }
    NAMED[GREYS + index_of_nearest(&table[GREYS..], |entry| by_hue(*entry, lab))].0
}

/// Index of the first entry at the smallest distance.
fn index_of_nearest(table: &[[f32; 3]], distance: impl Fn(&[f32; 3]) -> f32) -> usize {
    let mut best = (f32::INFINITY, 0);
    for (i, entry) in table.iter().enumerate() {
        let distance = distance(entry);
        if distance < best.0 {
            best = (distance, i);
        }
    }
    best.1
}

/// Squared distance of two colours in CIE Lab, where hue counts as much for dull colours as for others, and chroma
/// counts little.
fn by_hue(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [ca, cb] = [a, b].map(|c| c[1].hypot(c[2]));
    let turn = a[2].atan2(a[1]) - b[2].atan2(b[1]);
    let hue = 2.0 * (ca.max(COMPARED_CHROMA) * cb.max(COMPARED_CHROMA)).sqrt() * (0.5 * turn).sin();
    (a[0] - b[0]).powi(2) + (DULL * (ca - cb)).powi(2) + hue.powi(2)
}

fn unpack(code: u32) -> [f32; 3] {
    [16, 8, 0].map(|shift| ((code >> shift) & 255) as f32 / 255.0)
}

/// Returns colour number `index` of a sequence in which neighbours differ strongly: the hue turns by the golden ratio.
pub fn distinct_colour(index: usize) -> [u8; 3] {
    let hue = (index as f32 * 0.618_034 + 0.02).fract() * 6.0;
    let value = [1.0, 0.75, 0.9][index % 3];
    let channel = |shift: f32| {
        let at = (hue + shift).rem_euclid(6.0);
        let part = (2.0 - (at - 3.0).abs()).clamp(0.0, 1.0);
        ((0.08 + 0.92 * (1.0 - part)) * value * 255.0) as u8
    };
    [channel(0.0), channel(4.0), channel(2.0)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn plain_colours_get_their_plain_names() {
        let rows = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.7, 0.1, 1.0, 1.0, 0.0, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0];
        let names: Vec<String> = name_colours(&rows).into_iter().map(|e| e.name).collect();
        assert_eq!(names, ["red", "blue", "green", "yellow", "grey", "white"]);
    }

    #[test]
    fn a_dull_colour_with_a_visible_hue_is_not_grey() {
        for (code, name) in [
            (0x3c466e, "dark blue"),
            (0x404858, "dark blue"),
            (0x303850, "dark blue"),
            (0x101830, "dark blue"),
            (0x8090b0, "light blue"),
            (0xa0a8c0, "light blue"),
            (0x605040, "brown"),
            (0x485848, "dark green"),
            (0x4a3a3a, "dark grey"),
            (0xe0d8d0, "light grey"),
            (0x101014, "black"),
            (0xf0f0ff, "white"),
        ] {
            assert_eq!(name_colours(&unpack(code))[0].name, name, "{code:06x}");
        }
        let greys = NAMED[..GREYS].iter().all(|(name, _)| ["black", "white"].contains(name) || name.ends_with("grey"));
        assert!(greys && !NAMED[GREYS..].iter().any(|(name, _)| name.ends_with("grey")));
    }

    #[test]
    fn every_named_colour_is_its_own_nearest_and_names_are_unique() {
        let rows: Vec<f32> = NAMED.iter().flat_map(|&(_, code)| unpack(code)).collect();
        let palette = name_colours(&rows);
        for (entry, (name, code)) in palette.iter().zip(NAMED) {
            assert_eq!(entry.name, name);
            assert_eq!(entry.hex, format!("#{code:06x}"));
        }
        assert_eq!(NAMED.iter().map(|n| n.0).collect::<HashSet<_>>().len(), NAMED.len());
    }

    #[test]
    fn a_mixed_colour_is_nearest_to_the_one_of_its_hue() {
        let colours = [unpack(0xd7263d), unpack(0x2e86c1), unpack(0xf4f4f4)];
        for (code, nearest) in [(0x8a4a3a, 0), (0xd0605a, 0), (0x405870, 1), (0x90b8d8, 1), (0xe0e0e0, 2)] {
            assert_eq!(nearest_colour(&colours, unpack(code)), Some(nearest), "{code:06x}");
        }
        assert_eq!((nearest_colour(&[], [0.5; 3]), nearest_colour(&colours, [f32::NAN; 3])), (None, None));
    }

    #[test]
    fn repeated_names_are_numbered() {
        let names: Vec<String> = name_colours(&[0.5; 9]).into_iter().map(|e| e.name).collect();
        assert_eq!(names, ["grey", "grey-2", "grey-3"]);
    }

    #[test]
    fn materials_of_other_hues_never_share_a_name() {
        let of = |codes: &[u32]| -> Vec<String> {
            let rows: Vec<f32> = codes.iter().flat_map(|&c| unpack(c)).collect();
            name_materials(&rows).into_iter().map(|e| e.name).collect()
        };
        assert_eq!(of(&[0xe6191e, 0x1eaa28, 0x8cb4f0]), ["red", "green", "light blue"]);
        // two that are both nearest to blue, and two greys
        let blues = of(&[0x1946dc, 0x1e64dc]);
        assert!(blues[0] == "blue" && blues[1] != "blue" && blues[1].contains("blue"), "{blues:?}");
        assert_eq!(of(&[0x808080, 0x848484, 0x7c7c7c]).iter().collect::<HashSet<_>>().len(), 3);
        let many = of(&[0x808080; 12]);
        assert!(
            many.iter().all(|n| n.contains("grey") || n.starts_with("white") || n.starts_with("black")),
            "{many:?}"
        );
        assert_eq!(many.iter().collect::<HashSet<_>>().len(), 12);
        assert_eq!(name_materials(&[f32::NAN, 0.0, 0.0, f32::NAN, 0.0, 0.0])[1].name, "unknown-2");
    }

    #[test]
    fn non_finite_colours_are_still_shown() {
        let palette = name_colours(&[f32::NAN, 0.0, 0.0, 7.0, -3.0, -1.0]);
        assert_eq!((palette[0].name.as_str(), palette[0].hex.as_str()), ("unknown", "#000000"));
        assert_eq!((palette[1].name.as_str(), palette[1].hex.as_str()), ("red", "#ff0000"));
        assert!(name_colours(&[]).is_empty());
    }

    #[test]
    fn neighbouring_colours_differ() {
        for index in 0..40 {
            let (a, b) = (distinct_colour(index), distinct_colour(index + 1));
            assert!((0..3).map(|c| a[c].abs_diff(b[c]) as u32).sum::<u32>() > 120, "{index}");
        }
    }
}
