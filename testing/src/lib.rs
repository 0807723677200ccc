//! What the tests of both crates share: how a test skips itself where the machine lacks something ([`Need`]), and one
//! test a device ([`on_every_device`]).
//!
//! A test that finds something missing calls [`skip`] and returns. That says so on standard error, past libtest's capture,
//! so that a run shows what it did not test; and where the need's variable is set, it fails instead, so that a machine
//! which is meant to have the thing cannot lose it unnoticed.

mod devices;
mod need;
mod random;

pub use devices::skip_device;
pub use need::{Need, python_with, skip, test_data};
pub use random::generator;
