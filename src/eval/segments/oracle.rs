//! The oracle: of [`TRIES`] settings, the one whose selection fits the known segment best **in the clicked view**. No
//! user has it, as it knows the ground truth there; it shows what a method could achieve if its setting were always
//! chosen well. Every method has the same number of tries.

use super::click::Click;
use super::method::SelectionMethod;
use super::prompt::ClickPrompt;
use super::select::{MethodSelection, Scenery};
use super::setting::{MethodSetting, TRIES};
use std::time::Instant;

/// Gain in fit that a further click must exceed.
const WORTH: f64 = 0.005;

/// Returns the best selection of up to `clicks` clicks, the first among equals. Each further click is on what is still
/// missing, is tried at all settings again, and is kept only if it improves the fit enough.
///
/// # Errors
/// A message if the method failed.
pub fn best(
    scenery: Scenery<'_>,
    method: SelectionMethod,
    prompt: &ClickPrompt,
    clicks: usize,
) -> Result<MethodSelection, String> {
    let tries: [MethodSetting; TRIES] = MethodSetting::tries(method, scenery.config);
    let mut best: Option<MethodSelection> = None;
    let (mut click, mut seconds) = (Some(prompt.first()), f64::INFINITY);
    while let Some(place) = click.take() {
        let before = best.clone();
        let least = before.as_ref().map_or(-1.0, |b| b.fit.unwrap_or(0.0) + WORTH);
        let found = round(scenery, (method, &tries), &place, before.as_ref(), prompt, &mut seconds)?;
        let count = found.clicks;
        if found.fit.unwrap_or(0.0) <= least {
            break;
        }
        if count < clicks {
            click = prompt.next(&flags(&found.selected.members, scenery.at.len()));
        }
        best = Some(found);
    }
    let mut best = best.ok_or("no setting was tried")?;
    best.seconds = seconds;
    Ok(best)
}

/// Returns the best of all settings for one click, with what was selected `before` added.
fn round(
    scenery: Scenery<'_>,
    (method, tries): (SelectionMethod, &[MethodSetting]),
    click: &Click,
    before: Option<&MethodSelection>,
    prompt: &ClickPrompt,
    seconds: &mut f64,
) -> Result<MethodSelection, String> {
    let mut best: Option<MethodSelection> = None;
    for setting in tries {
        let started = Instant::now();
        let selected = scenery.select(method, setting, click)?;
        *seconds = seconds.min(started.elapsed().as_secs_f64());
        let selected = before.map_or_else(|| selected.clone(), |b| b.selected.with(&selected));
        let fit = prompt.fit(&flags(&selected.members, scenery.at.len()));
        if best.as_ref().is_none_or(|b| fit > b.fit.unwrap_or(0.0)) {
            let (said, clicks) = before.map_or((String::new(), 0), |b| (format!("{}; ", b.setting), b.clicks));
            let setting = format!("{said}{setting}");
            best = Some(MethodSelection { selected, setting, clicks: clicks + 1, seconds: 0.0, fit: Some(fit) });
        }
    }
    best.ok_or_else(|| "no setting was tried".to_owned())
}

/// Returns whether each Gaussian is one of `members`, `[N]`.
pub fn flags(members: &[u32], gaussians: usize) -> Vec<bool> {
    let mut flags = vec![false; gaussians];
    members.iter().for_each(|&i| flags[i as usize] = true);
    flags
}
