//! Scratch root.
