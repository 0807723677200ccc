//! Printing that never aborts the program: data on standard output, logs on standard error.
//!
//! Rust's own `println!` panics if the reader is gone (`volseggs ... | head`), the disk is full or the terminal was
//! closed, and none of these may end a training. Here an error stops the printing on that stream, not the work;
//! [`finish`] reports afterwards whether standard output accepted everything.

use std::fmt;
use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};

/// The first error on standard output; nothing is written to it after that.
static FAILURE: Mutex<Option<io::Error>> = Mutex::new(None);

/// Writes to standard output.
pub fn out(text: fmt::Arguments<'_>) {
    let mut failure = FAILURE.lock().unwrap_or_else(PoisonError::into_inner);
    if failure.is_none() {
        *failure = io::stdout().lock().write_fmt(text).err();
    }
}

/// Writes to standard error; errors are ignored.
pub fn err(text: fmt::Arguments<'_>) {
    let _ = io::stderr().lock().write_fmt(text);
}

/// Flushes standard output. A reader that has gone away is not an error.
///
/// # Errors
/// The first error in writing to standard output, such as a full disk.
pub fn finish() -> io::Result<()> {
    let mut failure = FAILURE.lock().unwrap_or_else(PoisonError::into_inner);
    let outcome = failure.take().map_or_else(|| io::stdout().flush(), Err);
    outcome.or_else(|e| if e.kind() == io::ErrorKind::BrokenPipe { Ok(()) } else { Err(e) })
}

/// `print!` that does not panic.
#[macro_export]
macro_rules! out {
    ($($text:tt)*) => { $crate::terminal::out(format_args!($($text)*)) };
}

/// `println!` that does not panic.
#[macro_export]
macro_rules! outln {
    () => { $crate::terminal::out(format_args!("\n")) };
    ($($text:tt)*) => { $crate::terminal::out(format_args!("{}\n", format_args!($($text)*))) };
}

/// `eprintln!` that does not panic.
#[macro_export]
macro_rules! errln {
    ($($text:tt)*) => { $crate::terminal::err(format_args!("{}\n", format_args!($($text)*))) };
}
