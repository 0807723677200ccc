//! A training run in a folder: the loop over the steps, and the parts that follow each step.
//!
//! [`run()`] takes the steps; everything else is a part with a file of its own. Before the first step: what the run
//! begins from (`beginning`). Around each step: pauses for an observer (`pauses`), reasons to stop (`stop`), test views
//! (`test_views`), logs (`logs`), progress on the terminal (`progress`), checkpoints (`checkpointer`) and the record
//! (`recorder`), in this order. All of them read the same clock (`clock`).

mod beginning;
mod checkpointer;
mod clock;
mod context;
mod logs;
mod pauses;
mod progress;
mod recorder;
mod stop;
mod test_views;

pub use super::record::RunRecord;
pub use beginning::lock_existing;
pub use context::{RunContext, RunOptions, RunStart};
pub use stop::StopReason;
pub use test_views::mean_psnr;

use super::observer::RunProgress;
use super::{StepReport, TrainError, Training};
use beginning::Beginning;
use checkpointer::Checkpointer;
use clock::RunClock;
use logs::TrainingLogs;
use pauses::Pauses;
use progress::ProgressReporter;
use recorder::RunRecorder;
use stop::StopRule;
use test_views::TestViews;

/// How a run ended.
#[derive(Clone, Debug)]
pub struct RunOutcome {
    /// The record as written.
    pub record: RunRecord,
    /// Why it ended.
    pub reason: StopReason,
    /// PSNR of the last evaluation on test views, decibels.
    pub test_psnr: Option<f64>,
}

/// A step that has just been taken, for the parts that follow it.
struct TakenStep<'a> {
    training: &'a dyn Training,
    report: StepReport,
    /// Steps of the whole training.
    total: usize,
    clock: &'a RunClock,
}

impl TakenStep<'_> {
    /// Steps taken, including this one.
    fn steps(&self) -> usize {
        self.report.step + 1
    }

    /// Whether what is due once in `every` steps, and at the end of the training, is due now; never if `every` is 0.
    fn is_due(&self, every: usize) -> bool {
        every > 0 && (self.steps().is_multiple_of(every) || self.steps() == self.total)
    }
}

/// Drives `training`, newly created from the dataset and the configuration of `context`, in the folder of the run until
/// the end, a stop or an error; see `volseggs::method::train`, which also creates it. The run is locked meanwhile.
///
/// # Errors
/// As [`Training::step`]; also if there is nothing to resume, if another process writes into the run, and if a file
/// cannot be written.
pub fn run(context: RunContext<'_>, mut training: Box<dyn Training>) -> Result<RunOutcome, TrainError> {
    let beginning = Beginning::prepare(&context, &mut *training)?;
    let mut clock = RunClock::start(beginning.seconds, context.config.output.max_minutes);
    let mut recorder = RunRecorder::begin(&context, &beginning, &*training)?;
    let RunContext { config, dataset, options, stop, observer, .. } = context;
    let mut checkpoints = Checkpointer::new(config, options, &beginning);
    let mut logs = TrainingLogs::open(&options.out, &beginning, &config.output)?;
    let mut test_views = TestViews::new(dataset.test.as_ref(), &config.output);
    let ending = StopRule::new(training.total_steps(), options.stop_after, stop);
    let (total, until) = (ending.total(), ending.limit());
    let mut progress = ProgressReporter::new(beginning.steps, until, total, config.output.eval_every);
    let mut pauses = Pauses { observer, stop };
    let mut last = None;
    let reason = loop {
        let (model, steps) = (training.model(), training.steps_done());
        let (record, seconds) = (recorder.record(), clock.seconds());
        let now = RunProgress { run: &options.out, config, record, model, steps, until, seconds, report: last };
        pauses.wait(&now, &mut clock, &progress);
        if let Some(reason) = ending.check(steps, &clock) {
            break reason;
        }
        progress.before_step();
        let report = *last.insert(training.step(&dataset.train)?);
        let step = TakenStep { training: &*training, report, total, clock: &clock };
        let new_psnr = test_views.after_step(&step);
        logs.after_step(&step, new_psnr)?;
        progress.after_step(&step, test_views.psnr());
        if checkpoints.after_step(&step)? {
            recorder.after_checkpoint(&step)?;
            logs.sync()?;
        }
    };
    progress.finish();
    logs.finish()?;
    checkpoints.finish(&*training, &clock)?;
    let record = recorder.finish(reason, &*training, &clock)?;
    Ok(RunOutcome { record, reason, test_psnr: test_views.psnr() })
}
