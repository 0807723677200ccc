//! Progress bars for long work, on standard error.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over `length` pieces of work called `unit`, with the time left and room for a message.
#[must_use]
pub fn bar(length: usize, unit: &str) -> ProgressBar {
    styled(length, &format!("{{bar:28}} {{pos}}/{{len}} {unit} {{elapsed}}<{{eta}} {{msg}}"))
}

/// A bar over `length` images, with their rate.
#[must_use]
pub fn image_bar(length: usize) -> ProgressBar {
    styled(length, "{bar:28} {pos}/{len} images {elapsed}<{eta} {per_sec}")
}

/// A bar over `length` steps of training that continues after `first` of them, with room for a message.
#[must_use]
pub fn step_bar(length: usize, first: usize) -> ProgressBar {
    let bar = styled(length, "{bar:28} {pos}/{len} {elapsed}<{eta} {msg}").with_position(first as u64);
    bar.reset_eta();
    bar
}

/// One line among several: a short bar over `length` steps, and a message.
#[must_use]
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
