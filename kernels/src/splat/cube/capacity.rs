//! How many tile entries to make room for.
//!
//! Only the device knows the number, and asking for it stalls the pipeline. A rendering that is shown or measured asks
//! each time and is exact. Training asks in the first steps and at every [`EVERY`]th, and otherwise goes by the most seen
//! for about as many Gaussians and that image size, with half as much again: should a view need still more, its farthest entries are left
//! out (entries are listed nearest first) and the next time that the number is asked for the room grows.

use crate::cube::Words;
use crate::splat::SplatSettings;
use burn_cubecl::cubecl::client::Client;
use std::collections::HashMap;
use std::sync::{LazyLock, Mutex};

/// Calls that ask, before only every [`EVERY`]th does.
const FIRST: u64 = 64;
/// Calls between two that ask.
const EVERY: u64 = 16;

/// What is known of renderings of one size.
#[derive(Default)]
struct Seen {
    calls: u64,
    most: usize,
}

/// By image size and the power of two that holds the Gaussians.
static SEEN: LazyLock<Mutex<HashMap<[usize; 3], Seen>>> = LazyLock::new(Mutex::default);

/// Room for entries; `starts[n]` on the device is their number. With `exact` it is asked for.
pub(super) fn capacity(client: &Client, starts: &Words, n: usize, settings: &SplatSettings, exact: bool) -> usize {
    let ask = || starts.read_at(client, n) as usize;
    if exact {
        return round(ask());
    }
    let key = [settings.camera.width, settings.camera.height, n.next_power_of_two()];
    let mut seen = SEEN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let seen = seen.entry(key).or_default();
    seen.calls += 1;
    if seen.calls <= FIRST || seen.calls.is_multiple_of(EVERY) {
        let count = ask();
        seen.most = seen.most.max(count);
        // the room of this call is exact; later ones go by the most seen
        return round(count);
    }
    round(seen.most + seen.most / 2)
}

/// A multiple of 4096, so that buffers of about one size are used again.
fn round(count: usize) -> usize {
    count.max(1).next_multiple_of(4096)
}
