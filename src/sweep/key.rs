//! Keys of runs: runs with the same key have the same result.
//!
//! A key is `RECIPE-BUILD`: what is trained, and the build of the program that trains it. Runs of one recipe by two
//! builds are kept side by side.

use crate::program::short;
use sha2::{Digest, Sha256};

/// Returns what is trained as 16 hexadecimal digits: a hash of the resolved configuration (TOML), the dataset's
/// fingerprint, the device, the version of the program and the sweep's `tag`.
pub fn recipe(config: &str, dataset: &str, device: &str, tag: &str) -> String {
    hash(&[env!("CARGO_PKG_VERSION"), config, dataset, device, tag])
}

/// Returns the key of a run of `recipe` by the build with digest `build`; the name of its folder.
pub fn key(recipe: &str, build: &str) -> String {
    format!("{recipe}-{}", short(build))
}

/// Splits a key into recipe and build.
pub fn parts(key: &str) -> (&str, &str) {
    key.split_once('-').unwrap_or((key, ""))
}

/// Whether `key` has the form of a key: two hexadecimal numbers.
pub fn is_key(key: &str) -> bool {
    let number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_hexdigit());
    key.split_once('-').is_some_and(|(recipe, build)| number(recipe) && number(build))
}

fn hash(texts: &[&str]) -> String {
    let mut hash = Sha256::new();
    for text in texts {
        // lengths first, so that parts cannot run into each other
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    }
    hex(&hash.finalize()[..8])
}

/// Returns a hash of `text`, eight hexadecimal digits.
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
        let base = recipe("a", "b", "c", "d");
        assert_eq!(base.len(), 16);
        assert_eq!(base, recipe("a", "b", "c", "d"));
        for other in [recipe("ab", "", "c", "d"), recipe("a", "b", "cd", ""), recipe("x", "b", "c", "d")] {
            assert_ne!(base, other);
        }
        assert_eq!(short_hash("jets").len(), 8);
    }

    #[test]
    fn a_recipe_is_the_same_on_every_machine() {
        // SHA-256 over length (u64, little-endian) and text of each
        assert_eq!(hash(&["0.1.0", "a", "b", "c", "d"]), "b322a87f47df7e12");
    }

    #[test]
    fn keys_split_into_recipe_and_build() {
        let build = "0123456789abcdef0123456789abcdef";
        let made = key("00112233aabbccdd", build);
        assert_eq!(made, "00112233aabbccdd-0123456789ab");
        assert_eq!(parts(&made), ("00112233aabbccdd", "0123456789ab"));
        assert!(is_key(&made));
        for wrong in ["", "00112233aabbccdd", "-", "00-", "-00", "00-11-22", "../11", "00-../11", "x0-11"] {
            assert!(!is_key(wrong), "{wrong}");
        }
    }
}
