//! Reads a run from its folder, and a newer checkpoint beside the drawing thread, so that frames go on meanwhile.

use super::training::{FileStamp, stamp};
use crate::edit::EditStack;
use crate::run::segments::RunSegments;
use crate::run::{OpenRun, RunError, affinity};
use crate::segment::fine::AffinityField;
use crate::segment::fine::file::AffinitySpec;
use burn::tensor::Device;
use std::path::Path;
use std::thread::JoinHandle;

/// Stamps of the files of segments, edits and affinity field.
pub type FileStamps = [FileStamp; 3];

/// Returns the stamps of the files of `run`.
pub fn stamps(run: &OpenRun) -> FileStamps {
    let paths = run.paths();
    [paths.segments(), paths.edits(), paths.affinity()].map(|path| stamp(&path))
}

/// Opens the affinity field of `run`. One that cannot be used counts as missing: the viewer then says how to make one.
pub fn field(run: &OpenRun) -> Option<(AffinityField, AffinitySpec)> {
    affinity::open(run).ok()
}

/// A run with all that is shown of it.
#[derive(Debug)]
pub struct OpenedRun {
    /// The run.
    pub run: OpenRun,
    /// The stamps of its files before they were read.
    pub seen: FileStamps,
    /// Its segments; none if those on disk belong to another state of its scene.
    pub segments: RunSegments,
    /// Why those on disk cannot be used, if so; nothing can be changed then.
    pub fault: Option<String>,
    /// Its edits.
    pub edits: EditStack,
    /// Its affinity field, if there is one.
    pub field: Option<(AffinityField, AffinitySpec)>,
}

impl OpenedRun {
    /// Reads the run, or one of its checkpoints, at `path`, with its dataset in the folder `data` if that was moved.
    ///
    /// # Errors
    /// If the run or a file of it cannot be used.
    pub fn new(path: &Path, data: Option<&Path>, device: &Device) -> Result<Self, RunError> {
        let run = OpenRun::open(path, device)?.with_dataset(data)?;
        let seen = stamps(&run);
        let ((segments, fault), edits) = (RunSegments::replacing(&run), run.edits()?);
        let (fault, field) = (fault.map(|e| e.to_string()), field(&run));
        Ok(Self { run, seen, segments, fault, edits, field })
    }

    /// Returns a run without anything that its files hold.
    pub fn scene_alone(run: OpenRun) -> Self {
        let (seen, segments, edits) = (FileStamps::default(), RunSegments::none(&run), EditStack::default());
        Self { run, seen, segments, fault: None, edits, field: None }
    }
}

/// The thread that reads a newer checkpoint, if there is one.
#[derive(Debug, Default)]
pub struct NewerCheckpoint(Option<JoinHandle<Result<OpenedRun, RunError>>>);

impl NewerCheckpoint {
    /// Begins to read `run` again.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn begin(&mut self, run: &OpenRun) -> Result<(), RunError> {
        let (path, data, device) = (run.path.clone(), run.given_dataset().map(Path::to_owned), run.device());
        let read = move || OpenedRun::new(&path, data.as_deref(), &device);
        let thread = std::thread::Builder::new().name("checkpoint".into()).spawn(read);
        self.0 =
            Some(thread.map_err(|e| RunError::failure(format!("cannot start a thread to read the checkpoint: {e}")))?);
        Ok(())
    }

    /// Whether one is being read, or was read and has not been taken.
    pub fn is_under_way(&self) -> bool {
        self.0.is_some()
    }

    /// Takes what was read; `None` while it is being read.
    pub fn take(&mut self) -> Option<Result<OpenedRun, RunError>> {
        let thread = self.0.take_if(|thread| thread.is_finished())?;
        Some(thread.join().unwrap_or_else(|_| Err(RunError::failure("the newer checkpoint cannot be read"))))
    }
}
