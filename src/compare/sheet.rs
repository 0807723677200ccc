//! The same view across variants: the ground truth, then each variant's render with a map of its errors below.
//!
//! The pictures are those that an evaluation writes to a run's `eval/test/pictures/`: pairs `NAME-truth.png` and
//! `NAME-render.png`. Unreadable ones are omitted from the sheet.

use super::places::{DatasetOnDevice, places};
use super::results::{OutcomeState, ResultSet, VariantOutcome};
use crate::data::png::check_claim;
use crate::draw::font::{GLYPH_HEIGHT, draw_text, text_width};
use crate::draw::views::{PicturePair, pair_sheet};
use crate::eval::sheet::error_color;
use crate::files::RunPaths;
use image::{Rgb, RgbImage};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Maximum number of variants on a sheet.
pub const MAX_VARIANTS: usize = 12;
/// Maximum side length of a picture, in pixels.
const MAX_CELL: u32 = 320;
/// Candidate errors for the brightest colour; the lowest that nearly all errors do not exceed is used.
const TOPS: [f32; 6] = [0.02, 0.05, 0.1, 0.2, 0.5, 1.0];
/// Fraction of the errors that may be off the scale.
const OFF_SCALE: f64 = 0.001;
const INK: [u8; 3] = [230, 230, 230];

/// One dataset's sheet.
#[derive(Clone, Debug)]
pub struct VariantSheet {
    /// Name of the dataset, and of the device where there are several.
    pub dataset: String,
    /// Name of the view.
    pub view: String,
    /// The picture.
    pub image: RgbImage,
    /// The error that the brightest colour of the maps stands for, as a fraction of full intensity.
    pub top_error: f32,
    /// Variants on the sheet, in order.
    pub shown: Vec<String>,
    /// Variants with a finished run that are not on the sheet: too many, or their pictures are missing or do not match.
    pub left_out: Vec<String>,
}

/// A variant's picture and its errors.
struct ShownVariant {
    variant: String,
    truth: RgbImage,
    render: RgbImage,
    errors: Vec<f32>,
}

/// Makes a sheet for each dataset and device whose variants with pictures share a view, in the order of the outcomes.
pub fn sheets(set: &ResultSet) -> Vec<VariantSheet> {
    places(set).into_iter().filter_map(|place| sheet(set, place)).collect()
}

fn folder(outcome: &VariantOutcome) -> PathBuf {
    RunPaths(&outcome.run).eval().join("test/pictures")
}

/// The finished outcome with the lowest seed of each variant.
fn first_seeds<'a>(set: &'a ResultSet, place: &DatasetOnDevice) -> Vec<&'a VariantOutcome> {
    let mut firsts: Vec<&VariantOutcome> = Vec::new();
    for outcome in set.outcomes.iter().filter(|o| place.holds(o) && o.state == OutcomeState::Done) {
        match firsts.iter_mut().find(|first| first.variant == outcome.variant) {
            Some(first) if outcome.seed < first.seed => *first = outcome,
            Some(_) => {}
            None => firsts.push(outcome),
        }
    }
    firsts
}

/// Names of the views for which both pictures exist.
fn views(folder: &Path) -> BTreeSet<String> {
    let Ok(entries) = std::fs::read_dir(folder) else { return BTreeSet::new() };
    let files: BTreeSet<String> = entries.flatten().filter_map(|e| e.file_name().into_string().ok()).collect();
    let names = files.iter().filter_map(|file| file.strip_suffix("-truth.png"));
    names.filter(|name| files.contains(&format!("{name}-render.png"))).map(str::to_owned).collect()
}

fn sheet(set: &ResultSet, place: DatasetOnDevice) -> Option<VariantSheet> {
    let firsts = first_seeds(set, &place);
    let with_views: Vec<(&VariantOutcome, BTreeSet<String>)> =
        firsts.iter().map(|o| (*o, views(&folder(o)))).filter(|(_, views)| !views.is_empty()).collect();
    let shared =
        with_views.iter().map(|(_, views)| views.clone()).reduce(|a, b| a.intersection(&b).cloned().collect())?;
    let view = shared.iter().nth(shared.len() / 2)?.clone();
    let mut shown: Vec<ShownVariant> = Vec::new();
    for (outcome, _) in with_views {
        if shown.len() == MAX_VARIANTS {
            break;
        }
        let next = load(outcome, &view);
        shown.extend(next.filter(|next| shown.first().is_none_or(|s| s.truth.dimensions() == next.truth.dimensions())));
    }
    let truth = shown.first()?.truth.clone();
    let top = top_error(&shown);
    let mut pairs = vec![PicturePair {
        name: "truth".to_owned(),
        note: view.clone(),
        below: Some(scale_of_errors(truth.dimensions(), top)),
        picture: truth,
    }];
    pairs.extend(shown.iter().map(|s| PicturePair {
        name: s.variant.clone(),
        note: psnr(s),
        picture: s.render.clone(),
        below: Some(error_map(s, top)),
    }));
    // four or five in a row, whichever leaves fewer cells empty
    let empty = |columns: &usize| pairs.len().next_multiple_of(*columns) - pairs.len();
    let columns = [4, 5].into_iter().min_by_key(empty).unwrap_or(4);
    let names: Vec<String> = shown.into_iter().map(|s| s.variant).collect();
    let left_out = firsts.iter().filter(|o| !names.contains(&o.variant)).map(|o| o.variant.clone()).collect();
    let image = pair_sheet(&pairs, columns, MAX_CELL);
    Some(VariantSheet { dataset: place.name, view, image, top_error: top, shown: names, left_out })
}

fn load(outcome: &VariantOutcome, view: &str) -> Option<ShownVariant> {
    let open = |kind: &str| {
        let bytes = crate::files::read_regular(&folder(outcome).join(format!("{view}-{kind}.png"))).ok()?;
        check_claim(&bytes, bytes.len() as u64).ok()?;
        Some(image::load_from_memory(&bytes).ok()?.to_rgb8())
    };
    let (truth, render) = (open("truth")?, open("render")?);
    if truth.dimensions() != render.dimensions() || truth.is_empty() {
        return None;
    }
    let difference =
        |(a, b): (&Rgb<u8>, &Rgb<u8>)| (0..3).map(|c| f32::from(a.0[c].abs_diff(b.0[c]))).sum::<f32>() / (3.0 * 255.0);
    let errors = truth.pixels().zip(render.pixels()).map(difference).collect();
    Some(ShownVariant { variant: outcome.variant.clone(), truth, render, errors })
}

/// The view's PSNR, as an evaluation computes it from the same 8-bit pictures.
fn psnr(shown: &ShownVariant) -> String {
    let pairs = shown.truth.as_raw().iter().zip(shown.render.as_raw());
    let squares: f64 = pairs.map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
    if squares == 0.0 {
        return "identical".to_owned();
    }
    let mean = squares / shown.truth.as_raw().len() as f64;
    format!("{:.2} dB", -10.0 * (mean / (255.0 * 255.0)).log10())
}

/// The common scale of all maps, so that they can be compared.
fn top_error(shown: &[ShownVariant]) -> f32 {
    let errors = || shown.iter().flat_map(|s| &s.errors);
    let few = (errors().count() as f64 * OFF_SCALE) as usize;
    TOPS.into_iter().find(|top| errors().filter(|e| *e > top).count() <= few).unwrap_or(1.0)
}

fn error_map(shown: &ShownVariant, top: f32) -> RgbImage {
    let (width, height) = shown.truth.dimensions();
    RgbImage::from_fn(width, height, |x, y| {
        let error = shown.errors[y as usize * width as usize + x as usize];
        Rgb(error_color(error / top))
    })
}

/// The legend of the error colours, as a picture of the cells' size.
fn scale_of_errors((width, height): (u32, u32), top: f32) -> RgbImage {
    let mut image = RgbImage::from_pixel(width, height, Rgb([24, 24, 28]));
    // about as large on the sheet as the labels
    let letters = (width.min(MAX_CELL) / 160).max(1) * width.div_ceil(MAX_CELL);
    let (bar, line) = ((height / 12).max(1), (GLYPH_HEIGHT + 4) * letters);
    let start = height / 2;
    for y in start..(start + bar).min(height) {
        for x in 0..width {
            image.put_pixel(x, y, Rgb(error_color((x as f32 + 0.5) / width as f32)));
        }
    }
    let top = format!("{top}");
    draw_text(&mut image, 0, start.saturating_sub(line), letters, INK, "error");
    let below = start + bar + 3 * letters;
    draw_text(&mut image, 0, below, letters, INK, "0");
    draw_text(&mut image, width.saturating_sub(text_width(&top, letters)), below, letters, INK, &top);
    image
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(root: &Path, variant: &str, seed: u64, state: OutcomeState) -> VariantOutcome {
        let run = root.join(format!("{variant}-{seed}"));
        VariantOutcome {
            variant: variant.to_owned(),
            dataset: "d".to_owned(),
            seed,
            run,
            state,
            ..VariantOutcome::default()
        }
    }

    fn pictures(outcome: &VariantOutcome, views: &[&str], size: u32, render: u8) {
        std::fs::create_dir_all(folder(outcome)).unwrap();
        for view in views {
            for (kind, shade) in [("truth", 100), ("render", render)] {
                let picture = RgbImage::from_pixel(size, size, Rgb([shade; 3]));
                picture.save(folder(outcome).join(format!("{view}-{kind}.png"))).unwrap();
            }
        }
    }

    fn set(outcomes: Vec<VariantOutcome>) -> ResultSet {
        ResultSet { outcomes, ..ResultSet::default() }
    }

    #[test]
    fn first_seeds_share_their_middle_view_and_one_scale() {
        let dir = tempfile::tempdir().unwrap();
        let done = |variant, seed| outcome(dir.path(), variant, seed, OutcomeState::Done);
        let (a2, a1, b, c) = (done("a", 2), done("a", 1), done("b", 1), done("c", 1));
        let failed = outcome(dir.path(), "f", 1, OutcomeState::Failed("no".to_owned()));
        pictures(&a2, &["r1"], 200, 0);
        pictures(&a1, &["r0", "r1", "r2", "r3"], 200, 110);
        pictures(&b, &["r1", "r2", "r3", "r9"], 200, 100);
        pictures(&failed, &["r0"], 200, 0);
        std::fs::write(folder(&b).join("r4-truth.png"), "alone").unwrap();
        let sheets = sheets(&set(vec![a2, a1, b, c, failed]));
        let [sheet] = &sheets[..] else { panic!("{}", sheets.len()) };
        assert_eq!((sheet.dataset.as_str(), sheet.view.as_str()), ("d", "r2"));
        assert_eq!((sheet.shown.join(" "), sheet.left_out.join(" ")), ("a b".to_owned(), "c".to_owned()));
        assert_eq!(sheet.top_error, 0.05, "10 of 255 is 0.039");
        let top = sheet.image.height() - 6 - 200;
        assert_eq!(sheet.image.get_pixel(6 + 206, top).0, error_color(10.0 / 255.0 / 0.05));
        assert_eq!(sheet.image.get_pixel(6 + 2 * 206, top).0, error_color(0.0));
    }

    #[test]
    fn devices_have_sheets_of_their_own() {
        let dir = tempfile::tempdir().unwrap();
        let on = |device: &str, variant| {
            let outcome = outcome(&dir.path().join(device), variant, 0, OutcomeState::Done);
            pictures(&outcome, &["r1"], 20, 100);
            VariantOutcome { device: device.to_owned(), ..outcome }
        };
        let sheets = sheets(&set(vec![on("flex", "a"), on("wgpu", "a"), on("flex", "b"), on("wgpu", "b")]));
        let shown: Vec<(&str, usize)> = sheets.iter().map(|s| (s.dataset.as_str(), s.shown.len())).collect();
        assert_eq!(shown, [("d, flex", 2), ("d, wgpu", 2)]);
    }

    #[test]
    fn pictures_that_do_not_match_the_others_are_omitted() {
        let dir = tempfile::tempdir().unwrap();
        let all: Vec<VariantOutcome> =
            (0..15).map(|i| outcome(dir.path(), &format!("v{i}"), 0, OutcomeState::Done)).collect();
        for (i, outcome) in all.iter().enumerate() {
            pictures(outcome, &["x"], if i == 1 { 8 } else { 9 }, 90);
        }
        std::fs::write(folder(&all[2]).join("x-render.png"), "no picture").unwrap();
        let sheets = sheets(&set(all));
        assert_eq!(sheets[0].shown.len(), MAX_VARIANTS);
        assert_eq!(sheets[0].left_out, ["v1", "v2", "v14"]);
    }

    #[test]
    fn no_pictures_give_no_sheet() {
        let dir = tempfile::tempdir().unwrap();
        assert!(sheets(&ResultSet::default()).is_empty());
        assert!(sheets(&set(vec![outcome(dir.path(), "a", 0, OutcomeState::Done)])).is_empty());
        let (a, b) = (outcome(dir.path(), "a", 0, OutcomeState::Done), outcome(dir.path(), "b", 0, OutcomeState::Done));
        pictures(&a, &["x"], 4, 0);
        pictures(&b, &["y"], 4, 0);
        assert!(sheets(&set(vec![a, b])).is_empty(), "no view in common");
        assert_eq!(scale_of_errors((1, 1), 0.5).dimensions(), (1, 1));
    }
}
