//! Progress bars of long work, on standard error, and durations in words.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over `length` pieces of work called `unit`, with the time left and room for a message.
#[must_use]
pub fn bar(length: usize, unit: &str) -> ProgressBar {
    let bar = ProgressBar::new(length as u64);
    let template = format!("{{bar:28}} {{pos}}/{{len}} {unit} {{elapsed}}<{{eta}} {{msg}}");
    if let Ok(style) = ProgressStyle::with_template(&template) {
        bar.set_style(style);
    }
    bar
}

/// Seconds as a person says them.
#[must_use]
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.1} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}
