//! Progress bars of long work, on standard error.

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
