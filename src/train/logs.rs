//! Entries of the training logs for a step.

use super::StepReport;
use super::report::StepTimes;
use crate::log::tensorboard::EventWriter;
use serde::Serialize;

/// A line of `metrics.jsonl`.
#[derive(Serialize)]
pub struct Line {
    step: usize,
    seconds: f64,
    stage: &'static str,
    loss: f64,
    train_psnr: f64,
    gaussians: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    test_psnr: Option<f64>,
    /// Of a step, the mean since the line before.
    milliseconds: Milliseconds,
}

#[derive(Serialize)]
struct Milliseconds {
    data: f64,
    deform: f64,
    splat: f64,
    loss: f64,
    backward: f64,
    adam: f64,
    densify: f64,
}

/// Returns the text of the progress bar beside the number of steps.
pub fn message(report: &StepReport, train: Option<f64>, test: Option<f64>) -> String {
    let test = test.map(|p| format!(" test {p:.2} dB")).unwrap_or_default();
    let train = train.unwrap_or_default();
    let count = if report.primitives > 0 { format!(" N={}", report.primitives) } else { String::new() };
    format!("{} loss {:.5} train {train:.2} dB{test}{count}", report.stage, report.loss)
}

/// Returns the line of a step, with the mean times `t` of the steps since the line before.
pub fn line(report: &StepReport, t: &StepTimes, seconds: f64, test_psnr: Option<f64>) -> Line {
    let ms = |d: std::time::Duration| (d.as_secs_f64() * 1e5).round() / 100.0;
    Line {
        step: report.step + 1,
        seconds: (seconds * 1e3).round() / 1e3,
        stage: report.stage,
        loss: report.loss,
        train_psnr: report.psnr,
        gaussians: report.primitives,
        test_psnr,
        milliseconds: Milliseconds {
            data: ms(t.data),
            deform: ms(t.deform),
            splat: ms(t.splat),
            loss: ms(t.loss),
            backward: ms(t.backward),
            adam: ms(t.adam),
            densify: ms(t.densify),
        },
    }
}

/// Writes the same values for TensorBoard.
///
/// # Errors
/// If the file cannot be written.
pub fn log_events(events: &mut EventWriter, line: &Line) -> std::io::Result<()> {
    let step = line.step as u64;
    events.scalar(step, "train/loss", line.loss as f32)?;
    events.scalar(step, "train/psnr", line.train_psnr as f32)?;
    events.scalar(step, "train/gaussians", line.gaussians as f32)?;
    if let Some(p) = line.test_psnr {
        events.scalar(step, "test/psnr", p as f32)?;
    }
    Ok(())
}
