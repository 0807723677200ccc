//! Who can fix an error: the user, with other input, or nobody at once, as the system failed.

/// An error that says whether the user can fix it. Programs end with different exit codes for the two.
pub trait UserError: std::error::Error {
    /// Whether the user can fix it, with other files, options or names; otherwise the system failed or refused.
    fn is_input(&self) -> bool;
}
