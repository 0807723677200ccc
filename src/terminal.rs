//! Printing that never fails the program: data on standard output, logs on standard error.
//!
//! Rust's own `println!` panics where the other end is gone (`volseggs ... | head`), the disk is full or the terminal
//! was closed, and a training must not die of that. Here an error ends the printing on that stream, not the work;
//! [`finish`] says afterwards whether standard output took everything.

use std::fmt;
use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};

/// What went wrong on standard output first; nothing is written to it after that.
static FAILURE: Mutex<Option<io::Error>> = Mutex::new(None);

/// Writes to standard output.
pub fn out(text: fmt::Arguments<'_>) {
    let mut failure = FAILURE.lock().unwrap_or_else(PoisonError::into_inner);
    if failure.is_none() {
        *failure = io::stdout().lock().write_fmt(text).err();
    }
}

/// Writes to standard error; whether anybody can read it is of no matter.
pub fn err(text: fmt::Arguments<'_>) {
    let _ = io::stderr().lock().write_fmt(text);
}

/// Hands what is buffered to the system. A reader that went away has had what it wanted: no error.
///
/// # Errors
/// What kept standard output from taking all that was printed, such as a full disk.
pub fn finish() -> io::Result<()> {
    let mut failure = FAILURE.lock().unwrap_or_else(PoisonError::into_inner);
    let outcome = failure.take().map_or_else(|| io::stdout().flush(), Err);
    outcome.or_else(|e| if e.kind() == io::ErrorKind::BrokenPipe { Ok(()) } else { Err(e) })
}

/// `print!` that does not panic.
macro_rules! out {
    ($($text:tt)*) => { $crate::terminal::out(format_args!($($text)*)) };
}

/// `println!` that does not panic.
macro_rules! outln {
    () => { $crate::terminal::out(format_args!("\n")) };
    ($($text:tt)*) => { $crate::terminal::out(format_args!("{}\n", format_args!($($text)*))) };
}

/// `eprintln!` that does not panic.
macro_rules! errln {
    ($($text:tt)*) => { $crate::terminal::err(format_args!("{}\n", format_args!($($text)*))) };
}
