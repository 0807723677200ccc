//! Recently deformed Gaussians by time and look, so that the second loop of a playback only splats.

use crate::run::look::PreparedLook;
use std::collections::HashMap;

/// Prepared Gaussians by key; the least recently used are dropped first.
#[derive(Debug)]
pub struct Cache {
    held: HashMap<String, (PreparedLook, u64)>,
    bytes: usize,
    max_bytes: usize,
    clock: u64,
}

impl Cache {
    /// Makes a cache that holds at most `max_bytes` bytes.
    pub fn new(max_bytes: usize) -> Self {
        Self { held: HashMap::new(), bytes: 0, max_bytes, clock: 0 }
    }

    /// Returns what is stored under `key`, if it is still there.
    pub fn get(&mut self, key: &str) -> Option<PreparedLook> {
        self.clock += 1;
        let (found, used) = self.held.get_mut(key)?;
        *used = self.clock;
        Some(found.clone())
    }

    /// Stores `prepared` under `key`, unless it alone is too large.
    pub fn put(&mut self, key: String, prepared: PreparedLook) {
        let bytes = prepared.bytes();
        if bytes > self.max_bytes {
            return;
        }
        self.clock += 1;
        if let Some((old, _)) = self.held.insert(key, (prepared, self.clock)) {
            self.bytes -= old.bytes();
        }
        self.bytes += bytes;
        while self.bytes > self.max_bytes {
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
    use crate::segment::test_support::APART;

    #[test]
    fn the_least_recently_used_entry_is_evicted_and_the_limit_is_kept() {
        let device = DeviceName::all()[0].open().unwrap();
        let one = PreparedLook::of(&APART.gaussians(), 0, &device);
        let bytes = one.bytes();
        assert!(bytes > 0);
        let mut cache = Cache::new(2 * bytes + 1);
        for key in ["a", "b"] {
            cache.put(key.into(), one.clone());
        }
        assert!(cache.get("a").is_some());
        cache.put("c".into(), one.clone());
        assert!(cache.get("b").is_none(), "least recently used");
        assert!(cache.get("a").is_some() && cache.get("c").is_some());
        cache.put("c".into(), one.clone());
        assert_eq!(cache.bytes, 2 * bytes, "replaced in place");
        cache.clear();
        assert!(cache.get("a").is_none() && cache.bytes == 0);
        let mut small = Cache::new(bytes - 1);
        small.put("a".into(), one);
        assert!(small.get("a").is_none(), "too large to be cached");
    }
}
