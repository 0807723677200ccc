//! Identifies the build of this program by a digest of its executable file.
//!
//! Two builds of one version can train differently, and only the file distinguishes them. The digest covers all bytes
//! of the file, so a custom program with extensions has its own; libraries loaded at start-up (LibTorch, drivers) are
//! not included.

use serde::Serialize;
use std::fs::File;
use std::io::{self, Read};
use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::Instant;
use twox_hash::XxHash3_128;

/// Number of digits of a digest that identify a build in folder names and messages: 48 bits.
const SHORT: usize = 12;
/// Bytes read at once.
const PIECE: usize = 1 << 20;

/// A build of the program.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Build {
    /// The 128-bit XXH3 hash of the executable file, 32 hexadecimal digits.
    pub digest: String,
    /// The file.
    pub file: PathBuf,
    /// Its size, bytes.
    pub bytes: u64,
    /// Time for reading and hashing it, milliseconds.
    pub milliseconds: f64,
}

/// The executable could not be read.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{}: {reason}; make the program readable, so that its build can be identified", file.display())]
pub struct BuildError {
    /// The executable.
    pub file: PathBuf,
    /// What the system reported.
    pub reason: String,
}

/// The build of this program; its file is read once per process.
///
/// # Errors
/// If the executable cannot be found or read.
pub fn build() -> Result<&'static Build, BuildError> {
    static BUILD: OnceLock<Result<Build, BuildError>> = OnceLock::new();
    let read = || {
        let file = std::env::current_exe().unwrap_or_else(|_| executable());
        let failed = |e: io::Error| BuildError { file: file.clone(), reason: e.to_string() };
        let started = Instant::now();
        let (digest, bytes) = File::open(executable()).and_then(digest).map_err(failed)?;
        Ok(Build { digest, bytes, milliseconds: started.elapsed().as_secs_f64() * 1e3, file: file.clone() })
    };
    BUILD.get_or_init(read).as_ref().map_err(Clone::clone)
}

/// The first digits of a build's digest, which serve as its name; the whole digest if it is shorter.
pub fn short(digest: &str) -> &str {
    digest.get(..SHORT).unwrap_or(digest)
}

/// Names a build within a sentence; it is empty where the program could not read its own file.
pub fn build_label(build: &str) -> String {
    if build.is_empty() { "a build that was not recorded".to_owned() } else { format!("build {}", short(build)) }
}

/// The file to execute in order to start this same program again. On Linux it is the file now running, even if another
/// has since replaced it.
pub fn executable() -> PathBuf {
    let own = PathBuf::from("/proc/self/exe");
    if cfg!(target_os = "linux") && own.exists() { own } else { std::env::current_exe().unwrap_or_default() }
}

/// The 128-bit XXH3 digest, 32 hexadecimal digits, and the number of all bytes of `source`.
///
/// # Errors
/// If it cannot be read.
pub fn digest(mut source: impl Read) -> io::Result<(String, u64)> {
    let (mut hash, mut piece, mut bytes) = (XxHash3_128::new(), vec![0; PIECE], 0);
    loop {
        match source.read(&mut piece) {
            Ok(0) => return Ok((format!("{:032x}", hash.finish_128()), bytes)),
            Ok(n) => {
                hash.write(&piece[..n]);
                bytes += n as u64;
            }
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_digest_is_xxh3_of_every_byte() {
        // as given by `xxh128sum`
        assert_eq!(digest(&b""[..]).unwrap(), ("99aa06d3014798d86001c324468d497f".to_owned(), 0));
        let long: Vec<u8> = (0..3 * PIECE + 7).map(|i| (i % 251) as u8).collect();
        let whole = digest(&long[..]).unwrap();
        assert_eq!(whole.0, format!("{:032x}", XxHash3_128::oneshot(&long)));
        for at in [0, PIECE, long.len() - 1] {
            let mut other = long.clone();
            other[at] ^= 1;
            assert_ne!(digest(&other[..]).unwrap(), whole, "byte {at}");
        }
    }

    #[test]
    fn this_build_is_identified_by_its_file() {
        let found = build().unwrap();
        assert_eq!(found.bytes, std::fs::metadata(executable()).unwrap().len());
        assert!(found.file.is_file() && short(&found.digest).len() == 12);
        assert_eq!(short("abc"), "abc");
        assert_eq!(build_label("0123456789abcdef"), "build 0123456789ab");
        assert_eq!(build_label(""), "a build that was not recorded");
    }
}
