//! Recently deformed Gaussians by time and look, so that the second loop of a playback only splats.

use crate::run::look::Prepared;
use std::collections::HashMap;

/// Prepared Gaussians by key; the least recently used are dropped first.
#[derive(Debug)]
pub struct Cache {
    held: HashMap<String, (Prepared, u64)>,
    bytes: usize,
    most: usize,
    clock: u64,
}

impl Cache {
    /// Makes a cache that holds at most `most` bytes.
    #[must_use]
    pub fn new(most: usize) -> Self {
        Self { held: HashMap::new(), bytes: 0, most, clock: 0 }
    }

    /// Returns what is stored under `key`, if it is still there.
    pub fn get(&mut self, key: &str) -> Option<Prepared> {
        self.clock += 1;
        let (found, used) = self.held.get_mut(key)?;
        *used = self.clock;
        Some(found.clone())
    }

    /// Stores `prepared` under `key`, unless it alone is too large.
    pub fn put(&mut self, key: String, prepared: Prepared) {
        let bytes = prepared.bytes();
        if bytes > self.most {
            return;
        }
        self.clock += 1;
        if let Some((old, _)) = self.held.insert(key, (prepared, self.clock)) {
            self.bytes -= old.bytes();
        }
        self.bytes += bytes;
        while self.bytes > self.most {
            let Some(oldest) = self.held.iter().min_by_key(|(_, (_, used))| *used).map(|(key, _)| key.clone()) else {
                break;
            };
            if let Some((gone, _)) = self.held.remove(&oldest) {
                self.bytes -= gone.bytes();
            }
        }
    }

    /// Clears the cache, for when the scene, its segments or edits change.
    pub fn clear(&mut self) {
        self.held.clear();
        self.bytes = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::DeviceName;
    use crate::segment::balls::APART;

    #[test]
    fn what_was_used_least_lately_goes_first_and_never_more_is_held_than_allowed() {
        let device = DeviceName::all()[0].open().unwrap();
        let one = Prepared::of(&APART.gaussians(), 0, &device);
        let bytes = one.bytes();
        assert!(bytes > 0);
        let mut cache = Cache::new(2 * bytes + 1);
        for key in ["a", "b"] {
            cache.put(key.into(), one.clone());
        }
        assert!(cache.get("a").is_some());
        cache.put("c".into(), one.clone());
        assert!(cache.get("b").is_none(), "used longest ago");
        assert!(cache.get("a").is_some() && cache.get("c").is_some());
        cache.put("c".into(), one.clone());
        assert_eq!(cache.bytes, 2 * bytes, "in its place");
        cache.clear();
        assert!(cache.get("a").is_none() && cache.bytes == 0);
        let mut small = Cache::new(bytes - 1);
        small.put("a".into(), one);
        assert!(small.get("a").is_none(), "too large to be held");
    }
}
