//! Whether a file with a final name is complete: it is read with the program's own reader for it.

use std::fmt::Display;
use std::path::Path;
use volseggs::data::Transforms;
use volseggs::data::dataset::{Dataset, OpenOptions, SplitName};
use volseggs::device::DeviceName;
use volseggs::edit::EditStack;
use volseggs::export::ply;
use volseggs::model::Scene;
use volseggs::model::scene_file::read_tensors;
use volseggs::prepare::PrepareRecord;
use volseggs::segment::fine::file as affinity;
use volseggs::segment::masks::MaskReader;
use volseggs::segment::segmentation::Segmentation;
use volseggs::train::checkpoint::CheckpointState;
use volseggs::train::run::RunRecord;
use volseggs::versioned;
use volseggs::volume::formats;

/// The last chunk of a PNG, checksum included.
const PNG_END: &[u8] = b"\0\0\0\0IEND\xAE\x42\x60\x82";

type Outcome = Result<(), String>;

fn text(error: impl Display) -> String {
    error.to_string()
}

/// Reads a whole file.
///
/// # Errors
/// What is wrong with it.
pub fn whole(path: &Path) -> Outcome {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let extension = path.extension().unwrap_or_default().to_string_lossy().into_owned();
    let bytes = std::fs::read(path).map_err(text)?;
    let ends = |end: &str| match String::from_utf8_lossy(&bytes).trim_end().ends_with(end) {
        true => Ok(()),
        false => Err(format!("{} bytes that do not end with {end}", bytes.len())),
    };
    let device = || DeviceName::Flex.open().map_err(text);
    match (name.as_str(), extension.as_str()) {
        // appended to, and empty at first
        (name, _) if name.starts_with("events.out.tfevents") => Ok(()),
        ("scene.safetensors", _) => Scene::load(path, &device()?).map(drop).map_err(text),
        ("segments.safetensors", _) => Segmentation::load(path).map(drop).map_err(text),
        ("affinity.safetensors", _) => affinity::load(path, &device()?).map(drop).map_err(text),
        ("optimizer.safetensors", _) => read_tensors(path).map(drop).map_err(text),
        (_, "safetensors") => volseggs::tensors::read(path).map(drop).map_err(text),
        ("edits.json", _) => EditStack::load(path).map(drop).map_err(text),
        ("run.json", _) => versioned::from_json::<RunRecord>(&bytes).map(drop).map_err(text),
        ("state.json", _) => versioned::from_json::<CheckpointState>(&bytes).map(drop).map_err(text),
        ("prepare.json", _) => versioned::from_json::<PrepareRecord>(&bytes).map(drop).map_err(text),
        (name, "json") if name.starts_with("transforms_") => Transforms::read(path).map(drop).map_err(text),
        (_, "json") => serde_json::from_slice::<serde_json::Value>(&bytes).map(drop).map_err(text),
        ("masks.jsonl", _) => masks(path),
        (_, "jsonl") => lines(&bytes, name == "metrics.jsonl"),
        (_, "toml") => String::from_utf8(bytes).map_err(text)?.parse::<toml::Table>().map(drop).map_err(text),
        (_, "png") => {
            // frames of an animation after the first are not decoded
            image::load_from_memory(&bytes).map_err(text)?;
            bytes.ends_with(PNG_END).then_some(()).ok_or_else(|| "no IEND at the end".to_owned())
        }
        (_, "ply") => ply::read(path).map(drop).map_err(text),
        (_, "vti" | "nrrd") => volume(path),
        (_, "svg") => ends("</svg>"),
        (_, "html") => ends("</html>"),
        (_, "csv") => bytes.ends_with(b"\n").then_some(()).ok_or_else(|| "its last line has no line break".to_owned()),
        // marks a folder
        ("comparison", _) => Ok(()),
        _ => (!bytes.is_empty()).then_some(()).ok_or_else(|| "empty".to_owned()),
    }
}

/// Reads all masks of all views.
fn masks(path: &Path) -> Outcome {
    let reader = MaskReader::open(path).map_err(text)?;
    (0..reader.header().views.len()).try_for_each(|view| reader.view(view).map(drop).map_err(text))
}

/// Checks that every line is JSON; the last line of a file that is appended to may be incomplete.
fn lines(bytes: &[u8], appended: bool) -> Outcome {
    for (i, line) in bytes.split_inclusive(|b| *b == b'\n').enumerate() {
        if !line.ends_with(b"\n") && appended {
            break;
        }
        serde_json::from_slice::<serde_json::Value>(line).map_err(|e| format!("line {}: {e}", i + 1))?;
    }
    Ok(())
}

/// Reads header and values.
fn volume(path: &Path) -> Outcome {
    let file = formats::open(path).map_err(text)?;
    let mut values = Vec::new();
    file.read(0, &mut values).map_err(text)?;
    let voxels: usize = file.header().grid.dims.iter().product();
    (values.len() == voxels).then_some(()).ok_or_else(|| format!("{} of {voxels} voxels", values.len()))
}

/// Checks a dataset that `prepare` made: its records and contact sheet, and every image that it lists.
///
/// # Errors
/// What is missing or damaged.
pub fn whole_dataset(folder: &Path) -> Outcome {
    for name in ["prepare.json", "contact-sheet.png", "transfer-function.toml", "segments.json"] {
        if !folder.join(name).is_file() {
            return Err(format!("the dataset exists without its {name}"));
        }
    }
    let options = OpenOptions { downscale: 1, splits: &[SplitName::Train, SplitName::Test], max_views: None };
    Dataset::open(folder, &options).map(drop).map_err(text)
}
