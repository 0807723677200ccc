//! Views in files: a picture that records what it shows, so that it can be drawn again, or the same record as JSON.
//!
//! A picture holds the JSON in a text chunk before its pixels. Reading accepts at most [`MAX_TEXT_BYTES`] of text and
//! searches only the first megabyte, whatever the file claims.

use super::cameras::SIDE;
use super::view::View;
use super::{OpenRun, RunError};
use crate::export::images::{encode_png_with, to_rgb8};
use crate::files::open_regular;
use crate::model::ToKernel;
use crate::shell;
use crate::versioned::{self, FORMAT};
use crate::words::plain;
use flate2::Crc;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fmt::Display;
use std::io::{self, Read};
use std::path::Path;

/// Maximum length of a view's text, bytes.
pub const MAX_TEXT_BYTES: usize = 64 * 1024;
/// How much of a picture is searched for the text, bytes.
const HEAD: u64 = 1 << 20;
/// Keyword of the text in a picture.
pub const KEYWORD: &str = "volseggs view";
/// The first bytes of a PNG.
const PNG: [u8; 8] = *b"\x89PNG\r\n\x1a\n";

/// A view and its origin.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SavedView {
    /// Version of the format, [`FORMAT`].
    pub format: u32,
    /// Version of the program that wrote it.
    pub version: String,
    /// Folder of the run.
    pub run: String,
    /// Fingerprint of its scene.
    pub scene: String,
    /// The command that draws it again.
    pub command: String,
    /// What it shows.
    pub view: View,
}

impl SavedView {
    /// Creates a view of a run, for a file of this name.
    pub fn new(run: &OpenRun, view: View, file: &str) -> Self {
        let command = command(run, "--view", file, "still");
        let (version, scene) = (env!("CARGO_PKG_VERSION").into(), run.scene.fingerprint());
        Self { format: FORMAT, version, run: run.path.display().to_string(), scene, command, view }
    }

    /// Draws `view` of the run as a PNG that records what it shows, to be saved as `file`. If the view has no colour
    /// scale, a suitable one is chosen and recorded.
    ///
    /// # Errors
    /// If it cannot be drawn.
    pub fn picture(run: &OpenRun, mut view: View, file: &str) -> Result<Vec<u8>, RunError> {
        view.check().map_err(RunError::input)?;
        let mut look = view.open_look(run)?;
        let camera = view.camera(1.0);
        let image = look.frame(&run.scene, (camera.to_kernel(), view.time as f32))?;
        view.range = look.legend().and_then(|l| l.scene_range);
        let image = to_rgb8(&image, camera.width as usize, camera.height as usize);
        let text = serde_json::to_string(&Self::new(run, view, file)).map_err(RunError::failure)?;
        encode_png_with(&image, KEYWORD, &text).map_err(RunError::failure)
    }

    /// Reads a picture or JSON file.
    ///
    /// # Errors
    /// If the file holds no view; the error names the file and the reason.
    pub fn read(path: &Path) -> Result<Self, RunError> {
        let name = path.display();
        let found = open_regular(path).and_then(|file| text(file.take(HEAD)));
        match found.map_err(|e| RunError::input(format!("{name}: {e}")))? {
            Some(text) => Self::parse(&name, &text),
            None => Err(RunError::input(format!(
                "{name}: a picture without a view; save one with `save picture` in `volseggs view`"
            ))),
        }
    }

    /// Parses the JSON text of a file, or of a view alone; `name` is used only in messages.
    ///
    /// # Errors
    /// If the text holds no valid view; the error says why.
    pub fn parse(name: impl Display, text: &str) -> Result<Self, RunError> {
        let wrong = |e: String| RunError::input(format!("{name}: not a valid view: {e}"));
        if text.len() > MAX_TEXT_BYTES {
            return Err(wrong(format!("longer than {MAX_TEXT_BYTES} bytes")));
        }
        let json = |e: serde_json::Error| wrong(plain(&e.to_string()));
        Self::from_value(&name, serde_json::from_str(text).map_err(json)?)
    }

    /// Like [`SavedView::parse`], for parsed JSON.
    ///
    /// # Errors
    /// As for [`SavedView::parse`].
    pub fn from_value(name: impl Display, value: Value) -> Result<Self, RunError> {
        let wrong = |e: String| RunError::input(format!("{name}: not a valid view: {e}"));
        let json = |e: serde_json::Error| wrong(plain(&e.to_string()));
        let saved = if value.get("view").is_some() {
            versioned::check(value.get(versioned::KEY)).map_err(|e| wrong(e.to_string()))?;
            serde_json::from_value::<Self>(value).map_err(json)?
        } else {
            let view = serde_json::from_value(value).map_err(json)?;
            Self {
                format: FORMAT,
                version: String::new(),
                run: String::new(),
                scene: String::new(),
                command: String::new(),
                view,
            }
        };
        saved.view.check().map_err(wrong)?;
        Ok(saved)
    }

    /// Returns this view at another width in pixels (the value of `--size`), with the same aspect ratio.
    ///
    /// # Errors
    /// If it would be taller than [`SIDE`].
    pub fn sized(mut self, width: u32) -> Result<Self, RunError> {
        let [w, h] = self.view.size;
        let height = (f64::from(h) * f64::from(width) / f64::from(w)).round().max(1.0);
        if height > f64::from(SIDE) {
            let most = (f64::from(SIDE) * f64::from(w) / f64::from(h)).floor().max(1.0);
            return Err(RunError::input(format!(
                "--size {width}: a view of the shape {w}x{h} would be {height} pixels tall, but the maximum is {SIDE}; \
                 choose at most {most}"
            )));
        }
        self.view.size = [width, height as u32];
        Ok(self)
    }

    /// Returns whether it was saved from another scene than this run's.
    pub fn is_of_another(&self, run: &OpenRun) -> bool {
        !self.scene.is_empty() && self.scene != run.scene.fingerprint()
    }
}

/// Returns the command that renders what an option of the run selects; `value` is the name of a file, or the JSON of a
/// view itself.
pub fn command(run: &OpenRun, option: &str, value: &str, out: &str) -> String {
    format!("volseggs render {} {option} {} --out {out}", shell::path(&run.path), shell::quote(value))
}

/// Returns the text of a view in a PNG, or all of another file; `None` for a PNG without such a text.
fn text(mut file: impl Read) -> io::Result<Option<String>> {
    let mut start = Vec::new();
    file.by_ref().take(8).read_to_end(&mut start)?;
    if start == PNG {
        return text_of_png(file);
    }
    file.take(MAX_TEXT_BYTES as u64).read_to_end(&mut start)?;
    let text = String::from_utf8(start);
    text.map(Some).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "neither a PNG nor text"))
}

/// Returns the text in the chunks before the pixels.
fn text_of_png(mut file: impl Read) -> io::Result<Option<String>> {
    let damaged = || io::Error::new(io::ErrorKind::InvalidData, "the text in the picture is damaged");
    loop {
        let mut head = [0; 8];
        if file.read_exact(&mut head).is_err() || &head[4..] == b"IDAT" {
            return Ok(None);
        }
        let [a, b, c, d, kind @ ..] = head;
        let length = u64::from(u32::from_be_bytes([a, b, c, d]));
        // the keyword and the five bytes between it and the text
        let most = (MAX_TEXT_BYTES + KEYWORD.len() + 5) as u64;
        if &kind != b"iTXt" || length > most {
            io::copy(&mut file.by_ref().take(length + 4), &mut io::sink())?;
            continue;
        }
        let (mut data, mut sum) = (vec![0; length as usize], [0; 4]);
        file.read_exact(&mut data).and_then(|()| file.read_exact(&mut sum)).map_err(|_| damaged())?;
        // keyword, 0; compression flag and method, both 0; no language, 0; no translated keyword, 0; the text
        let Some(text) = data.strip_prefix(KEYWORD.as_bytes()).and_then(|d| d.strip_prefix(&[0; 5])) else { continue };
        let mut crc = Crc::new();
        crc.update(&kind);
        crc.update(&data);
        if crc.sum() != u32::from_be_bytes(sum) {
            return Err(damaged());
        }
        return String::from_utf8(text.to_vec()).map(Some).map_err(|_| damaged());
    }
}

#[cfg(test)]
mod tests {
    use super::super::view::tests::view;
    use super::*;
    use crate::user_error::UserError;
    use image::RgbImage;

    fn saved() -> SavedView {
        let mut view = view();
        (view.eye, view.range) = ([0.1 + 0.2, -1e-7, 4.0], Some([0.1, 123.456]));
        view.hidden = vec!["red".into()];
        let text = |t: &str| t.to_owned();
        SavedView { format: 1, version: text("9"), run: text("rün"), scene: text("s"), command: text("c"), view }
    }

    fn reads(bytes: &[u8]) -> Result<SavedView, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.png");
        std::fs::write(&path, bytes).unwrap();
        SavedView::read(&path).map_err(|e| {
            assert!(e.is_input() && e.to_string().starts_with(&path.display().to_string()), "{e}");
            e.to_string()
        })
    }

    #[test]
    fn views_round_trip_bit_identically_through_pictures_and_text() {
        let json = serde_json::to_string(&saved()).unwrap();
        let image = RgbImage::from_fn(5, 4, |x, y| image::Rgb([x as u8, y as u8, 9]));
        let png = encode_png_with(&image, KEYWORD, &json).unwrap();
        assert_eq!(image::load_from_memory(&png).unwrap().to_rgb8(), image, "the text changes no pixel");
        assert_eq!(reads(&png).unwrap(), saved());
        assert_eq!(reads(json.as_bytes()).unwrap(), saved());
        let alone = SavedView::parse("--view", &serde_json::to_string(&saved().view).unwrap()).unwrap();
        assert_eq!((alone.view, alone.scene), (saved().view, String::new()));
        assert_eq!(saved().sized(400).unwrap().view.size, [400, 300]);
        let mut tall = saved();
        tall.view.size = [4, 4096];
        assert_eq!(tall.clone().sized(16).unwrap().view.size, [16, 16_384]);
        let error = tall.sized(17).unwrap_err();
        assert!(error.is_input() && error.to_string().contains("the maximum is 16384; choose at most 16"), "{error}");
    }

    #[test]
    fn files_without_a_view_are_refused_by_name() {
        let json = serde_json::to_string(&saved()).unwrap();
        let image = RgbImage::new(5, 4);
        let png = |keyword: &str, text: &str| encode_png_with(&image, keyword, text).unwrap();
        let good = png(KEYWORD, &json);
        for (bytes, word) in [
            (png("Comment", &json), "without a view"),
            (png(KEYWORD, &"x".repeat(100_000)), "without a view"),
            (good[..200].to_vec(), "damaged"),
            (png(KEYWORD, "{}"), "missing"),
            (b"GIF89a\xff\xff\xff\xff".to_vec(), "neither"),
            (b"{\"view\": 3}".to_vec(), "format: is missing"),
            (b"{\"format\": 1, \"view\": 3}".to_vec(), "not a valid view"),
            (" ".repeat(1 << 20).into_bytes(), "longer"),
            ("[".repeat(60_000).into_bytes(), "not a valid view"),
            (json.replace("\"time\":0.5", "\"time\":7").into_bytes(), "between 0 and 1"),
            (json.replace("\"format\":1", "\"format\":2").into_bytes(), "is 2, but this program reads 1"),
            (Vec::new(), "not a valid view"),
        ] {
            let error = reads(&bytes).unwrap_err();
            assert!(error.contains(word), "{error}: {word}");
        }
        // no changed byte of the text goes unnoticed, and no damage causes a panic
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 0x10;
            drop(reads(&bad).map(|found| assert_eq!(found, saved())));
        }
    }
}
