//! Number of tile entries to make room for.
//!
//! Only the device knows the exact number, and querying it stalls the pipeline. A rendering that is shown or measured
//! queries it each time and is exact. Training queries it in the first steps and at every [`QUERY_INTERVAL`]th, and
//! otherwise uses 1.5 times the maximum seen for a similar number of Gaussians and that image size: should a view need
//! still more, its farthest entries are omitted (entries are listed nearest first), and the room grows at the next
//! query. The half in reserve is cut to what `fits` into a buffer.

use crate::cube::Words;
use crate::splat::SplatSettings;
use burn_cubecl::cubecl::client::Client;
use std::collections::HashMap;
use std::sync::{LazyLock, Mutex};

/// Initial calls that query the number, before only every [`QUERY_INTERVAL`]th does.
const INITIAL_QUERIES: u64 = 64;
/// Interval between calls that query the number.
const QUERY_INTERVAL: u64 = 16;

/// Statistics of renderings of one size.
#[derive(Default)]
struct EntryStatistics {
    calls: u64,
    max_entries: usize,
}

/// Statistics by image size and the number of Gaussians rounded up to a power of two.
static SEEN: LazyLock<Mutex<HashMap<[usize; 3], EntryStatistics>>> = LazyLock::new(Mutex::default);

/// Returns the room for entries; `starts[n]` on the device is their number, which `exact` queries. It may not fit if the
/// entries themselves do not.
pub(super) fn capacity(
    client: &Client,
    starts: &Words,
    n: usize,
    settings: &SplatSettings,
    exact: bool,
    fits: &dyn Fn(usize) -> bool,
) -> usize {
    let ask = || starts.read_at(client, n) as usize;
    if exact {
        return round(ask());
    }
    let key = [settings.camera.width, settings.camera.height, n.next_power_of_two()];
    let mut seen = SEEN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let seen = seen.entry(key).or_default();
    seen.calls += 1;
    if seen.calls <= INITIAL_QUERIES || seen.calls.is_multiple_of(QUERY_INTERVAL) {
        let count = ask();
        seen.max_entries = seen.max_entries.max(count);
        // the room of this call is exact; later ones use the maximum seen
        return round(count);
    }
    reserved(seen.max_entries, fits)
}

/// Returns the room for half as many entries again as were seen, or for as many as fit.
fn reserved(seen: usize, fits: &dyn Fn(usize) -> bool) -> usize {
    (0..=8).map(|k| round(seen + seen / 16 * (8 - k))).find(|room| fits(*room)).unwrap_or(round(seen))
}

/// Rounds up to a multiple of 4096, so that buffers of similar size are reused.
fn round(count: usize) -> usize {
    count.max(1).next_multiple_of(4096)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reserve_is_cut_to_what_fits_but_not_the_entries() {
        let room = |limit: usize| reserved(1 << 20, &|room| room <= limit);
        assert_eq!(room(usize::MAX), 3 << 19);
        assert_eq!(room((3 << 19) - 1), (1 << 20) + 7 * (1 << 16));
        assert_eq!((room(1 << 20), room(1), reserved(0, &|_| true)), (1 << 20, 1 << 20, 4096));
    }
}
