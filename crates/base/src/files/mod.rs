//! Files and folders that the program writes: completely or not at all, one writer at a time, and replacing only what
//! it made itself. Nothing about any file format belongs here.

mod atomic;
#[cfg(test)]
mod atomic_tests;
mod lock;
mod open;
mod replace;
mod run_paths;

pub use atomic::{AtomicDir, AtomicFile, remove_whole, write_atomic, write_named};
pub use lock::{LOCK_PATIENCE, LockDuration, LockError, LockHolder, RunLock};
pub use open::{NotText, decode_text, is_user_error, leads_out, open_regular, read_regular, read_settings, read_text};
pub use replace::{FolderKind, MARK, ReplaceError, WriteError, check_file, has_mark, same_file};
pub use run_paths::RunPaths;
