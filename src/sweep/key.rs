//! Keys of runs: the same key, the same result.

use sha2::{Digest, Sha256};

/// Key of a run, 16 hexadecimal digits: a hash of the resolved configuration (TOML), the dataset's fingerprint, the
/// device, the version of the program and the sweep's `tag`.
#[must_use]
pub fn key(config: &str, dataset: &str, device: &str, tag: &str) -> String {
    let mut hash = Sha256::new();
    for part in [env!("CARGO_PKG_VERSION"), config, dataset, device, tag] {
        // lengths first, so that parts cannot run into each other
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    hex(&hash.finalize()[..8])
}

/// Eight hexadecimal digits that tell one text from another.
#[must_use]
pub fn short_hash(text: &str) -> String {
    hex(&Sha256::digest(text)[..4])
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_part_matters_and_parts_do_not_run_together() {
        let base = key("a", "b", "c", "d");
        assert_eq!(base.len(), 16);
        assert_eq!(base, key("a", "b", "c", "d"));
        for other in [key("ab", "", "c", "d"), key("a", "b", "cd", ""), key("x", "b", "c", "d")] {
            assert_ne!(base, other);
        }
        assert_eq!(short_hash("jets").len(), 8);
    }
}
