//! Progress of long work on standard error: bars on a terminal, lines in a log.

use crate::durations::rough_duration;
use indicatif::{ProgressBar, ProgressStyle};
use std::sync::{Mutex, PoisonError};

/// Seconds until the first line.
const FIRST_LINE: f64 = 5.0;
/// Longest time between two lines, seconds.
const LONGEST_WAIT: f64 = 60.0;

/// A bar over `length` pieces of work called `unit`, with the time left and room for a message.
pub fn bar(length: usize, unit: &str) -> ProgressBar {
    styled(length, &format!("{{bar:28}} {{pos}}/{{len}} {unit} {{elapsed}}<{{eta}} {{msg}}"))
}

/// A bar over `length` images, with their rate.
pub fn image_bar(length: usize) -> ProgressBar {
    styled(length, "{bar:28} {pos}/{len} images {elapsed}<{eta} {per_sec}")
}

/// A bar over `length` steps of training that continues after `first` of them, with room for a message.
pub fn step_bar(length: usize, first: usize) -> ProgressBar {
    let bar = styled(length, "{bar:28} {pos}/{len} {elapsed}<{eta} {msg}").with_position(first as u64);
    bar.reset_eta();
    bar
}

/// One line among several: a short bar over `length` steps, and a message.
pub fn line(length: usize) -> ProgressBar {
    styled(length, "  {bar:20} {pos}/{len} {msg}")
}

fn styled(length: usize, template: &str) -> ProgressBar {
    let bar = ProgressBar::new(length as u64);
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

/// Progress as lines, for logs, where no bar can be drawn: the first after five seconds, then at twice the time of the
/// last one, but at least every minute.
#[derive(Debug)]
pub struct ProgressLines {
    first: usize,
    total: usize,
    /// Seconds after which the next line is due.
    next: Mutex<f64>,
}

impl ProgressLines {
    /// Lines about `total` pieces of work, of which `first` were done before.
    pub fn new(first: usize, total: usize) -> Self {
        Self { first, total, next: Mutex::new(FIRST_LINE) }
    }

    /// Whether a line is due with `done` pieces done, `seconds` after the work began: at intervals, and at the end.
    pub fn is_due(&self, done: usize, seconds: f64) -> bool {
        let mut next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
        if done < self.total && seconds < *next {
            return false;
        }
        *next = seconds + seconds.clamp(FIRST_LINE, LONGEST_WAIT);
        true
    }

    /// The time left in words, from the mean time of the pieces so far, and at most `most` seconds: `, 3 min left`; empty
    /// at the beginning and the end.
    pub fn left(&self, done: usize, seconds: f64, most: f64) -> String {
        let (here, open) = (done.saturating_sub(self.first), self.total.saturating_sub(done));
        if here == 0 || open == 0 {
            return String::new();
        }
        format!(", {} left", rough_duration((seconds * open as f64 / here as f64).min(most)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_soon_then_seldom_and_at_the_end() {
        let lines = ProgressLines::new(0, 1000);
        let due: Vec<u32> = (0..=240).filter(|s| lines.is_due(1, f64::from(*s))).collect();
        assert_eq!(due, [5, 10, 20, 40, 80, 140, 200]);
        assert!(lines.is_due(1000, 241.0));
    }

    #[test]
    fn the_time_left_follows_from_what_this_process_did() {
        let lines = ProgressLines::new(500, 1000);
        let left = |done| lines.left(done, 10.0, f64::INFINITY);
        assert_eq!((left(500), left(600), left(1000)), (String::new(), ", 40 s left".to_owned(), String::new()));
        assert_eq!(lines.left(600, 10.0, 25.0), ", 25 s left");
    }
}
