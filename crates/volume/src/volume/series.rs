//! A time-varying volume: many files of one step, or one file of many. Steps are read one at a time, on demand; at most
//! one file is kept open. The formats themselves are read in [`crate::volume::formats`].

mod dates;
mod inputs;
#[cfg(test)]
mod meaning_tests;
mod names;
mod notes;
#[cfg(test)]
mod packed_tests;
mod pieces;
mod place;
mod rounding;
#[cfg(test)]
mod tests;
mod times;

use crate::volume::error::VolumeError;
use crate::volume::formats;
use crate::volume::grid::{Grid, ScalarType, Volume, VolumeLabels};
use crate::volume::source::{PhysicalMetadata, VolumeFile, VolumeHeader, VolumeVariable};
use notes::FileNotes;
use place::compare;
use rayon::prelude::*;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use times::SeriesTimes;

/// Voxels scanned by one task.
const CHUNK: usize = 1 << 16;

/// Maximum number of values of small steps that are read together.
const MAX_TOGETHER: usize = 1 << 24;

/// How a series is assembled.
#[derive(Clone, Debug, Default)]
pub struct SeriesOptions {
    /// Replaces NaN and infinite voxels, in data units, but counts in no range or histogram; `None` makes them an
    /// error.
    pub nan_as: Option<f32>,
    /// Accept missing numbers in file names.
    pub allow_gaps: bool,
    /// The time of each step in any unit, strictly increasing; `None` takes those of the file or the dates in the names
    /// of the files, or spaces the steps evenly.
    pub times: Option<Vec<f64>>,
    /// Unit of length, instead of the one that the files name.
    pub length_unit: Option<String>,
    /// Unit of time, instead of the one that the file names.
    pub time_unit: Option<String>,
    /// Accept files at different places: all are taken to be where the first is.
    pub ignore_origin: bool,
    /// The array to read from files that hold several; `None` for the one that the first file marks as active, or its
    /// first.
    pub variable: Option<String>,
}

/// The values of a series, over all steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeriesScan {
    /// The smallest and largest value that is finite in the files, in data units; `None` if there is none.
    pub range: Option<[f32; 2]>,
    /// Number of voxels that are NaN, infinite or too large for single precision in the files.
    pub not_finite: u64,
}

/// An opened file, kept for the next step.
type Kept = (usize, Arc<dyn VolumeFile>);

/// Volumes on one grid, in order of time.
#[derive(Debug)]
pub struct Series {
    files: Vec<PathBuf>,
    header: VolumeHeader,
    times: SeriesTimes,
    notes: Vec<String>,
    nan_as: Option<f32>,
    variable: Option<String>,
    /// Whether a file stores numbers of more digits than single precision has.
    wide: Option<ScalarType>,
    kept: Mutex<Option<Kept>>,
    scan: OnceLock<SeriesScan>,
}

impl Series {
    /// Opens the files named by `inputs`: paths, folders (all volume files inside), or patterns such as `t*.nrrd`, the
    /// last two in natural order. All headers are read and compared, but no values.
    ///
    /// # Errors
    /// No file, files out of order, a missing or repeated step, files on different grids, a 4D file among others,
    /// invalid times, a unit of unknown times, a file without the array that the first file gives, or a file that cannot
    /// be read.
    pub fn open(inputs: &[String], options: &SeriesOptions) -> Result<Self, VolumeError> {
        let files = inputs::expand(inputs)?;
        let told = inputs::check_order(inputs, &files, options)?;
        if let Some(value) = options.nan_as.filter(|v| !v.is_finite()) {
            let problem = format!("{value} is not finite");
            return Err(VolumeError::invalid(&files[0], "--nan", problem, "give a finite number"));
        }
        let first: Arc<dyn VolumeFile> = Arc::from(formats::open_variable(&files[0], options.variable.as_deref())?);
        let mut header = first.header().clone();
        // the same array in all files, whichever each marks as active
        let variable = first.variable().map(str::to_owned);
        let mut notes = FileNotes::default();
        notes.add(&files[0], &header.notes);
        let mut mixed = false;
        let mut wide = Some(header.scalar).filter(|s| s.is_wide());
        for file in &files[1..] {
            let other = formats::open_variable(file, variable.as_deref())?;
            compare(&files[0], &header, file, other.header(), options.ignore_origin, &mut notes)?;
            mixed |= other.header().scalar != header.scalar;
            wide = wide.or(Some(other.header().scalar).filter(|s| s.is_wide()));
        }
        let mut notes = notes.lines();
        notes.extend(told.notes);
        if mixed {
            notes.push(format!("the files differ in scalar type, the first is {}", header.scalar.name()));
        }
        if told.gaps && options.times.is_none() {
            notes.push("numbers are missing in the file names, the steps are assumed evenly spaced in time".into());
        }
        let steps = if files.len() == 1 { header.steps } else { files.len() };
        let dates = told.seconds.filter(|seconds| seconds.len() == steps);
        let times = SeriesTimes::new(&files[0], steps, options, dates, &header.physical, &mut notes)?;
        times::replace("--length-unit", &mut header.physical.length_unit, &options.length_unit, &mut notes);
        let kept = Mutex::new(Some((0, first)));
        Ok(Self { files, header, times, notes, nan_as: options.nan_as, variable, wide, kept, scan: OnceLock::new() })
    }

    /// The files, in order of time.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// Number of steps, at least 1.
    #[expect(clippy::len_without_is_empty, reason = "a series is never empty")]
    pub fn len(&self) -> usize {
        self.times.scene.len()
    }

    /// The grid of every step.
    pub fn grid(&self) -> &Grid {
        &self.header.grid
    }

    /// What the grid is in.
    pub fn physical(&self) -> &PhysicalMetadata {
        &self.header.physical
    }

    /// The time of each step, ascending, in the unit of [`Series::time_unit`]; `None` where it is unknown.
    pub fn time_values(&self) -> Option<&[f64]> {
        self.times.values.as_deref()
    }

    /// The unit of time, if it is named.
    pub fn time_unit(&self) -> Option<&str> {
        self.times.unit.as_deref()
    }

    /// How the first file stores values.
    pub fn scalar(&self) -> ScalarType {
        self.header.scalar
    }

    /// Name of the array that is read, in formats whose files hold several.
    pub fn variable(&self) -> Option<&str> {
        self.variable.as_deref()
    }

    /// The arrays of the first file, in formats whose files hold several.
    ///
    /// # Errors
    /// The file has changed.
    pub fn variables(&self) -> Result<Vec<VolumeVariable>, VolumeError> {
        Ok(self.opened(0)?.variables().to_vec())
    }

    /// What the conversion of all steps to single precision loses, for users, where that matters: whole numbers are no
    /// longer exact, or the field has few different values. `None` until [`Series::scan`] has read them.
    pub fn rounding(&self) -> Option<String> {
        rounding::lost(self.wide?, self.scan.get()?.range?)
    }

    /// The display name of a step: the file name, with `[k]` for step `k` of a 4D file. Empty beyond the last step.
    pub fn name(&self, step: usize) -> String {
        let (file, k) = self.place(step);
        let name = self.files.get(file).and_then(|f| f.file_name()).unwrap_or_default().to_string_lossy();
        if self.header.steps > 1 { format!("{name}[{k}]") } else { name.into_owned() }
    }

    /// The time of a step in `[0, 1]`: 0 the first, 1 the last; 0 for a single step. NaN beyond the last step.
    pub fn time(&self, step: usize) -> f64 {
        self.times.scene.get(step).copied().unwrap_or(f64::NAN)
    }

    /// What the user should know about the files, one sentence each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Reads a step. NaN and infinite voxels are replaced if the options say so.
    ///
    /// # Errors
    /// No such step, a file that cannot be read, or a voxel that is NaN or infinite.
    pub fn load(&self, step: usize) -> Result<Volume, VolumeError> {
        let mut values = Vec::new();
        self.read(step, &mut values)?;
        Ok(Volume { grid: self.header.grid, values })
    }

    /// Reads a step as labels.
    ///
    /// # Errors
    /// No such step, a file that cannot be read, or a voxel that is not a whole number from 0 to 65535.
    pub fn load_labels(&self, step: usize) -> Result<VolumeLabels, VolumeError> {
        let mut values = Vec::new();
        let path = self.read_as_stored(step, &mut values)?;
        let label = |v: f32| (0.0..=65535.0).contains(&v) && v.fract() == 0.0;
        if let Some((count, at)) = offenders(&values, |v| !label(v)) {
            let problem = format!("{count} voxels are not labels, the first holds {}", values[at]);
            let hint = "labels are whole numbers from 0 to 65535, 0 for no segment";
            return Err(VolumeError::invalid(path, self.voxel(at), problem, hint));
        }
        Ok(VolumeLabels { grid: self.header.grid, ids: values.par_iter().map(|&v| v as u16).collect() })
    }

    /// The smallest and largest value over all steps, in data units, of the voxels that are finite in the files: what
    /// replaces the others is no measurement, and must not stretch the range that transfer functions refer to. Reads
    /// every step the first time, one in memory at a time.
    ///
    /// # Errors
    /// As for [`Series::load`], or no voxel is finite.
    pub fn range(&self) -> Result<[f32; 2], VolumeError> {
        self.scan()?.range.ok_or_else(|| {
            let hint = "check the type and the byte order that the header gives, and how the file was written";
            VolumeError::invalid(&self.files[0], "values", "no voxel of any step is finite", hint)
        })
    }

    /// The range of the voxels that are finite in the files, and the number of the others, over all steps. Reads every
    /// step the first time, one in memory at a time.
    ///
    /// # Errors
    /// As for [`Series::load`].
    pub fn scan(&self) -> Result<SeriesScan, VolumeError> {
        if let Some(scan) = self.scan.get() {
            return Ok(*scan);
        }
        let nothing = ([f32::INFINITY, f32::NEG_INFINITY], 0u64);
        let add = |([low, high], bad): ([f32; 2], u64), v: f32| {
            if v.is_finite() { ([low.min(v), high.max(v)], bad) } else { ([low, high], bad + 1) }
        };
        let merge = |a: ([f32; 2], u64), b: ([f32; 2], u64)| ([a.0[0].min(b.0[0]), a.0[1].max(b.0[1])], a.1 + b.1);
        let (mut found, mut values) = (nothing, Vec::new());
        // many small steps of one file are read together: compressed files are decompressed from the start each time
        let at_a_time = if self.files.len() > 1 { 1 } else { (MAX_TOGETHER / self.header.grid.len().max(1)).max(1) };
        for first in (0..self.len()).step_by(at_a_time) {
            self.read_range(first..self.len().min(first + at_a_time), &mut values)?;
            let part = |c: &[f32]| c.iter().copied().fold(nothing, add);
            found = merge(found, values.par_chunks(CHUNK).map(part).reduce(|| nothing, merge));
        }
        let (range, not_finite) = found;
        // -0 and 0 are equal; which of them is found must not depend on the order
        let range = (range[0] <= range[1]).then(|| range.map(|v| v + 0.0));
        Ok(*self.scan.get_or_init(|| SeriesScan { range, not_finite }))
    }

    /// Counts the voxels of a step in `bins` equal parts of `range` (data units, `range[1]` is in the last bin). Voxels
    /// outside `range`, and those not finite in the file, are not counted; where both ends are equal, voxels of that
    /// value are in the first bin.
    ///
    /// # Errors
    /// As for [`Series::load`].
    pub fn histogram(&self, step: usize, bins: usize, range: [f32; 2]) -> Result<Vec<u64>, VolumeError> {
        let mut values = Vec::new();
        self.read_unreplaced(step, &mut values)?;
        let mut counts = vec![0u64; bins];
        let (lo, hi) = (f64::from(range[0]), f64::from(range[1]));
        let scale = if hi > lo { bins as f64 / (hi - lo) } else { 0.0 };
        if let Some(last) = bins.checked_sub(1) {
            for &v in values.iter().filter(|v| v.is_finite() && (range[0]..=range[1]).contains(*v)) {
                counts[(((f64::from(v) - lo) * scale) as usize).min(last)] += 1;
            }
        }
        Ok(counts)
    }

    /// The file of a step, and the step within it.
    fn place(&self, step: usize) -> (usize, usize) {
        if self.files.len() == 1 { (0, step) } else { (step, 0) }
    }

    fn voxel(&self, at: usize) -> String {
        let [nx, ny, _] = self.header.grid.dims;
        format!("voxel x={} y={} z={}", at % nx, at / nx % ny, at / nx / ny)
    }

    fn read(&self, step: usize, values: &mut Vec<f32>) -> Result<(), VolumeError> {
        let path = self.read_as_stored(step, values)?;
        let Some((count, at)) = offenders(values, |v| !v.is_finite()) else { return Ok(()) };
        let Some(value) = self.nan_as else {
            let first = values[at];
            let wide = matches!(self.header.scalar, ScalarType::F64);
            let kind = match (first.is_nan(), wide) {
                (true, _) => "is NaN",
                (false, false) => "is infinite",
                (false, true) => "is infinite, or too large for single precision (at most 3.4e38)",
            };
            let problem =
                format!("{count} voxels of {} are NaN, infinite or too large; the first {kind}", self.name(step));
            let hint = "replace them with --nan VALUE";
            return Err(VolumeError::invalid(path, self.voxel(at), problem, hint));
        };
        values.par_iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = value);
        Ok(())
    }

    /// Reads a step as it is in the file. Voxels that are not finite are an error unless the options replace them.
    fn read_unreplaced(&self, step: usize, values: &mut Vec<f32>) -> Result<(), VolumeError> {
        if self.nan_as.is_none() { self.read(step, values) } else { self.read_as_stored(step, values).map(|_| ()) }
    }

    /// Reads consecutive steps of one file, as [`Series::read_unreplaced`] does.
    fn read_range(&self, steps: Range<usize>, values: &mut Vec<f32>) -> Result<(), VolumeError> {
        if steps.len() == 1 {
            return self.read_unreplaced(steps.start, values);
        }
        self.opened(0)?.read_range(steps.clone(), values)?;
        if self.nan_as.is_none()
            && let Some((_, at)) = offenders(values, |v| !v.is_finite())
        {
            // reports which voxel it is
            return self.read(steps.start + at / self.header.grid.len().max(1), values);
        }
        Ok(())
    }

    fn read_as_stored(&self, step: usize, values: &mut Vec<f32>) -> Result<&Path, VolumeError> {
        if step >= self.len() {
            let problem = format!("there is no step {step}, the series has {}", self.len());
            return Err(VolumeError::invalid(&self.files[0], "step", problem, "steps are counted from 0"));
        }
        let (file, k) = self.place(step);
        let path = &self.files[file];
        self.opened(file)?.read(k, values)?;
        if values.len() == self.header.grid.len() {
            return Ok(path);
        }
        let problem = format!("{} values were read, the grid has {}", values.len(), self.header.grid.len());
        Err(VolumeError::invalid(path, "size", problem, "write the file again"))
    }

    fn opened(&self, file: usize) -> Result<Arc<dyn VolumeFile>, VolumeError> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, open)) = kept.as_ref().filter(|k| k.0 == file) {
            return Ok(Arc::clone(open));
        }
        // the previous one is closed first
        *kept = None;
        let path = &self.files[file];
        let open: Arc<dyn VolumeFile> = Arc::from(formats::open_variable(path, self.variable.as_deref())?);
        if open.header().grid.dims != self.header.grid.dims || open.header().steps != self.header.steps {
            return Err(VolumeError::invalid(path, "sizes", "changed since the series was opened", "start again"));
        }
        *kept = Some((file, Arc::clone(&open)));
        Ok(open)
    }
}

/// The number of values that are `bad`, and the index of the first of them.
fn offenders(values: &[f32], bad: impl Fn(f32) -> bool + Sync) -> Option<(usize, usize)> {
    let part = |(i, c): (usize, &[f32])| {
        let count = c.iter().filter(|&&v| bad(v)).count();
        let first = c.iter().position(|&v| bad(v)).map_or(usize::MAX, |at| i * CHUNK + at);
        (count, first)
    };
    let found = values.par_chunks(CHUNK).enumerate().map(part);
    let (count, first) = found.reduce(|| (0, usize::MAX), |a, b| (a.0 + b.0, a.1.min(b.1)));
    (count > 0).then_some((count, first))
}
