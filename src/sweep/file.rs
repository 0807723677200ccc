//! A sweep file as written: TOML, typed, nothing resolved yet.

use super::SweepError;
use crate::compare::PaperTable;
use crate::name::Name;
use crate::volume::synthetic::Synthetic;
use crate::volume::transfer::Lighting;
use crate::words::plain;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// The contents of a sweep file.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SweepFile {
    /// Where it was read from, for messages.
    #[serde(skip)]
    pub path: PathBuf,
    /// Heading of the report; the file's name if empty.
    pub title: String,
    /// A sentence or two for the report.
    pub note: String,
    /// Heading of the column of variants.
    pub head: String,
    /// Configuration that all variants start from: a file beside this one, or a preset; `best` if not given.
    pub config: Option<String>,
    /// Keys set in every run; dotted, or in sections.
    pub set: Table,
    /// Seeds; each variant runs with each of them. 0 if not given.
    pub seeds: Option<Vec<u64>>,
    /// Devices, as an axis.
    pub devices: Vec<String>,
    /// Metrics to report.
    pub metrics: Vec<String>,
    /// Variant that differences are relative to; the first if not given.
    pub baseline: Option<String>,
    /// Part of the key of each run: change it to repeat runs that a change of the code may affect.
    pub tag: String,
    /// Datasets by name, as an axis: a folder, or a synthetic scene to be rendered.
    pub data: BTreeMap<String, Value>,
    /// How runs are measured.
    pub eval: EvalSpec,
    /// Named variants.
    pub variant: Vec<VariantSpec>,
    /// Values by key, in all combinations.
    pub grid: Table,
    /// Samples from ranges.
    pub random: Option<RandomSpec>,
    /// Early stopping of unpromising variants.
    pub halving: Option<HalvingSpec>,
    /// How segmentation is measured; not at all if not given.
    pub segments: Option<Table>,
    /// The paper's figures, to compare orderings with.
    pub paper: Option<PaperTable>,
}

/// `[eval]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvalSpec {
    /// At most this many test views, evenly spaced; all if not given.
    pub views: Option<usize>,
    /// LPIPS weights; relative to the sweep file.
    pub lpips_weights: Vec<PathBuf>,
}

/// `[[variant]]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VariantSpec {
    /// Its name in the table.
    pub name: String,
    /// Configuration that it starts from instead of the sweep's: a file beside the sweep, or a preset, such as that of
    /// a method.
    #[serde(default)]
    pub config: Option<String>,
    /// Keys it sets.
    #[serde(default)]
    pub set: Table,
    /// Seeds instead of the sweep's, such as fewer for a variant that takes long.
    #[serde(default)]
    pub seeds: Option<Vec<u64>>,
}

/// `[random]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RandomSpec {
    /// How points are drawn.
    #[serde(default)]
    pub method: SampleMethod,
    /// Number of points.
    pub count: usize,
    /// Seed of the draw.
    #[serde(default)]
    pub seed: u32,
    /// Range or choices by key.
    pub keys: BTreeMap<String, RangeSpec>,
}

/// How points are drawn from ranges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SampleMethod {
    /// Owen-scrambled Sobol points, which fill space evenly for any number of points.
    #[default]
    Sobol,
    /// Latin hypercube: each axis is divided into as many parts as there are points, each used once.
    LatinHypercube,
    /// Independent uniform numbers.
    Uniform,
}

/// A range, or choices.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RangeSpec {
    /// Lower end.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
    /// Whether values are spread evenly in the logarithm.
    pub log: bool,
    /// Whether values are integers, both ends included.
    pub integer: bool,
    /// Choices, instead of a range.
    pub choices: Vec<Value>,
}

/// `[halving]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HalvingSpec {
    /// Steps at which the worst variants are stopped, in rising order.
    pub rungs: Vec<usize>,
    /// Fraction of the variants that continue, in (0, 1).
    #[serde(default = "half")]
    pub keep: f64,
}

fn half() -> f64 {
    0.5
}

/// A synthetic scene to be rendered as a dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SyntheticSpec {
    /// Which scene: jets, vortices, shells, layers, beads or filaments; or FAMILY:SEED, such as blobs:7.
    pub synthetic: String,
    /// Width and height of images in pixels.
    #[serde(default = "side")]
    pub size: u32,
    /// Number of times used in training.
    #[serde(default = "times")]
    pub times: usize,
    /// Number of training views per time.
    #[serde(default = "views")]
    pub views: usize,
    /// Number of test views.
    #[serde(default = "test_views")]
    pub test_views: usize,
    /// Voxels per axis; about one per pixel if not given.
    pub voxels: Option<usize>,
    /// Whether to render images of each segment alone and label images, for `[segments]`.
    #[serde(default)]
    pub segments: bool,
    /// Number of test views that show each segment alone at each of five times, as in `prepare`; if not given, seven,
    /// each at its own time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment_views: Option<usize>,
    /// Lighting instead of the scene's own.
    #[serde(default, skip_serializing_if = "is_default")]
    pub shading: Lighting,
}

fn is_default(lighting: &Lighting) -> bool {
    *lighting == Lighting::default()
}

fn side() -> u32 {
    200
}
fn times() -> usize {
    20
}
fn views() -> usize {
    10
}
fn test_views() -> usize {
    61
}

/// Where a dataset comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum DataSource {
    /// A folder.
    Folder(PathBuf),
    /// A scene that is rendered first.
    Synthetic(SyntheticSpec),
}

impl SweepFile {
    /// Reads a sweep file.
    ///
    /// # Errors
    /// If it cannot be read, is not TOML, or has an unknown key or a value of the wrong type.
    pub fn read(path: &Path) -> Result<Self, SweepError> {
        let bad = |problem: String| SweepError::File { path: path.to_owned(), problem };
        let text = crate::files::read_settings(path).map_err(|e| match e.kind() {
            ErrorKind::NotFound => {
                bad("not found; give a sweep file, such as configs/ablations/loss-small.toml".into())
            }
            _ => bad(e.to_string()),
        })?;
        crate::nesting::check_toml(&text).map_err(bad)?;
        let mut file: Self = toml::from_str(&text).map_err(|e| bad(plain(&e.to_string())))?;
        path.clone_into(&mut file.path);
        if file.title.is_empty() {
            file.title = name_of(path);
        }
        if file.head.is_empty() {
            file.head = "variant".to_owned();
        }
        let dir = path.parent().unwrap_or(Path::new(""));
        let configs = file.variant.iter_mut().map(|variant| &mut variant.config).chain([&mut file.config]);
        configs.flatten().for_each(|name| *name = beside(dir, name));
        for weights in &mut file.eval.lpips_weights {
            *weights = std::path::absolute(dir.join(&*weights)).map_err(|e| bad(e.to_string()))?;
        }
        Ok(file)
    }

    /// Returns the error of one of its keys, or of an option that stands for one.
    pub(super) fn wrong(&self, key: impl Into<String>, problem: impl Display) -> SweepError {
        SweepError::Key { path: self.path.clone(), key: key.into(), problem: problem.to_string() }
    }

    /// Sets keys of every synthetic dataset, each `KEY=VALUE` with a value of TOML, such as `size=64`.
    ///
    /// # Errors
    /// A message, if there is no synthetic dataset or a setting has another form; unknown keys are found by
    /// [`SweepFile::datasets`].
    pub(super) fn set_synthetic(&mut self, settings: &[String]) -> Result<(), String> {
        let mut scenes: Vec<&mut Table> = self.data.values_mut().filter_map(Value::as_table_mut).collect();
        for setting in settings {
            if scenes.is_empty() {
                return Err(format!("{setting}: the file has no synthetic dataset"));
            }
            let read = |(key, value): (&str, &str)| {
                let mut table: Table = format!("value = {value}").parse().ok()?;
                Some((key.trim().to_owned(), table.remove("value").filter(|_| table.is_empty())?))
            };
            let Some((key, value)) = setting.split_once('=').and_then(read) else {
                return Err(format!("\"{setting}\": expected KEY=VALUE, such as size=64"));
            };
            scenes.iter_mut().for_each(|scene| drop(scene.insert(key.clone(), value.clone())));
        }
        Ok(())
    }

    /// The datasets by name.
    ///
    /// # Errors
    /// A dataset that is neither a folder nor a synthetic scene.
    pub fn datasets(&self) -> Result<Vec<(String, DataSource)>, SweepError> {
        let dir = self.path.parent().unwrap_or(Path::new(""));
        let read = |(name, value): (&String, &Value)| {
            let bad = |problem: String| self.wrong(format!("data.{name}"), problem);
            let source = match value {
                Value::String(folder) => DataSource::Folder(dir.join(folder)),
                Value::Table(table) => {
                    let spec: SyntheticSpec =
                        table.clone().try_into().map_err(|e: toml::de::Error| bad(plain(e.message())))?;
                    spec.scene().map_err(bad)?;
                    spec.check().map_err(bad)?;
                    DataSource::Synthetic(spec)
                }
                _ => return Err(bad("expected a folder (text) or a table such as { synthetic = \"jets\" }".into())),
            };
            // the folder of a rendered scene is named after it
            let name = Name::new(name.as_str()).map_err(|e| bad(e.to_string()))?;
            Ok((name.into(), source))
        };
        self.data.iter().map(read).collect()
    }
}

impl SyntheticSpec {
    /// Returns the named scene.
    ///
    /// # Errors
    /// A message if there is no scene of that name.
    pub fn scene(&self) -> Result<Synthetic, String> {
        self.synthetic.parse().map_err(|e| format!("{e}"))
    }

    /// Refuses sizes that are out of range.
    ///
    /// # Errors
    /// A message about the first invalid key.
    pub fn check(&self) -> Result<(), String> {
        let images = self.times.saturating_mul(self.views);
        for (key, value, min, max) in [
            ("size", self.size as usize, 8, 16_384),
            ("times", self.times, 1, 100_000),
            ("views", self.views, 1, 100_000),
            ("times * views", images, 1, 1_000_000),
            ("test_views", self.test_views, 1, 100_000),
            ("voxels", self.voxels(), 2, 4096),
            ("segment_views", self.segment_views.unwrap_or(1), 1, self.test_views),
        ] {
            if !(min..=max).contains(&value) {
                return Err(format!("{key} = {value}: must be from {min} to {max}"));
            }
        }
        if self.segment_views.is_some() && !self.segments {
            return Err("segment_views needs segments = true; otherwise no segment is rendered".to_owned());
        }
        self.shading.check().map_err(|e| format!("shading.{e}"))
    }

    /// Voxels per axis; by default, a voxel is about as large as a pixel.
    pub fn voxels(&self) -> usize {
        self.voxels.unwrap_or((self.size as usize * 12 / 25).clamp(24, 256))
    }
}

/// Maximum length of the name of a sweep's folder, in bytes.
const MAX_NAME_BYTES: usize = 80;

/// The file's name without its extension, as a [`Name`] of a folder.
pub fn name_of(path: &Path) -> String {
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let fits = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' };
    let name: String = stem.chars().map(fits).take(MAX_NAME_BYTES).collect();
    match name.trim_start_matches(['.', '-']) {
        "" => "sweep".to_owned(),
        // the folders of the runs and datasets of all sweeps
        taken @ ("runs" | "datasets") => format!("sweep-{taken}"),
        name => name.to_owned(),
    }
}

/// The file `name` beside the sweep file if there is one, else `name` itself: a preset, or a path from the working
/// directory.
fn beside(dir: &Path, name: &str) -> String {
    let found = [dir.join(name), dir.join(format!("{name}.toml"))].into_iter().find(|p| p.is_file());
    found.map_or_else(|| name.to_owned(), |p| p.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sweep_names_are_valid_and_not_reserved() {
        let long = format!("{}.toml", "x".repeat(300));
        for path in ["a b.toml", "...toml", "-x.toml", ".toml", "runs.toml", "datasets.toml", "\u{e9}.toml", &long] {
            let name = name_of(Path::new(path));
            assert!(Name::new(name.as_str()).is_ok(), "{path}: {name}");
            assert!(name != "runs" && name != "datasets");
        }
        assert_eq!(name_of(Path::new("x/my sweep.toml")), "my-sweep");
    }
}
