//! Memory: how much the process has used, and how much it may still allocate.
//!
//! Sizes given by the user (pixels, frames, Gaussians, voxels) are checked against a [`MemoryBudget`] before anything
//! is allocated, because Rust aborts when an allocation fails.

use std::fmt;
use std::path::Path;
use std::str::FromStr;
use std::sync::OnceLock;

/// Bytes per mebibyte. A megabyte (MB) is 10^6 bytes.
pub const MIB: f64 = 1_048_576.0;

/// Peak resident memory of this process in bytes; 0 if the system does not report it.
pub fn peak_memory() -> u64 {
    status("VmHWM:").unwrap_or(0)
}

/// Lets mimalloc keep the pages of freed memory, which by default it returns to the system within seconds: each training
/// step and each frame allocates the same hundreds of mebibytes again, and the system would clear every page of them
/// anew. `MIMALLOC_PURGE_DELAY` in the environment takes precedence. Without effect on other allocators.
pub fn keep_freed_pages() {
    // SAFETY: the call changes one number, and no other thread is reading it yet or minds which of the two it reads.
    unsafe { libmimalloc_sys::mi_option_set_default(PURGE_DELAY, -1) };
}

/// `mi_option_purge_delay`, which the bindings do not name: milliseconds; -1 is never.
const PURGE_DELAY: libmimalloc_sys::mi_option_t = libmimalloc_sys::mi_option_use_numa_nodes - 1;

/// A field of `/proc/self/status` in bytes.
fn status(field: &str) -> Option<u64> {
    kibibytes("/proc/self/status", field)
}

/// A field of `/proc/meminfo` in bytes, such as `MemTotal:`; `None` if the system does not report it.
pub fn system(field: &str) -> Option<u64> {
    kibibytes("/proc/meminfo", field)
}

/// The value of `field` in a file that counts in kibibytes, in bytes.
fn kibibytes(file: &str, field: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(field))?;
    Some(line.split_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

/// The limit set on the command line.
static ALLOWED: OnceLock<Bytes> = OnceLock::new();
/// Free memory assumed if the system does not report it, bytes.
const ASSUMED: u64 = 8_000_000_000;

/// Bytes of memory that may still be allocated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryBudget(u64);

/// A size that does not fit into memory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}: needs about {} of memory, but {} are free; reduce it, or allow more with --memory", Bytes::rounded(*needed), Bytes(*free))]
pub struct TooLarge {
    /// The flag or key with its value.
    pub what: String,
    /// Bytes.
    pub needed: u128,
    /// Bytes.
    pub free: u64,
}

impl MemoryBudget {
    /// The memory free now: what `--memory` allows, or else the minimum left by the system, the container and the
    /// process limit (`ulimit -v`).
    pub fn now() -> Self {
        if let Some(allowed) = ALLOWED.get() {
            return Self(allowed.0.saturating_sub(status("VmRSS:").unwrap_or(0)));
        }
        let limits = [system("MemAvailable:"), container(), address_space()];
        Self(limits.into_iter().flatten().min().unwrap_or(ASSUMED))
    }

    /// A budget of `bytes` bytes.
    pub fn from_bytes(bytes: u64) -> Self {
        Self(bytes)
    }

    /// Sets the limit of the whole process, overriding what the system reports; only the first call has an effect.
    pub fn allow(bytes: Bytes) {
        let _ = ALLOWED.set(bytes);
    }

    /// Rejects a request for more bytes than are free. `what` is the flag or key with its value, such as
    /// `--size 100000`.
    ///
    /// # Errors
    /// [`TooLarge`], naming `what`.
    pub fn check(self, what: impl fmt::Display, bytes: u128) -> Result<(), TooLarge> {
        if bytes <= u128::from(self.0) {
            return Ok(());
        }
        Err(TooLarge { what: what.to_string(), needed: bytes, free: self.0 })
    }
}

/// A saturating product of sizes.
pub fn product(sizes: &[usize]) -> u128 {
    sizes.iter().fold(1, |all: u128, n| all.saturating_mul(*n as u128))
}

/// Memory left by the control groups (both versions) of a container or batch job; file caches count as free.
fn container() -> Option<u64> {
    let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let path = |start: &str| groups.lines().find_map(|l| l.split_once(start).map(|(_, path)| path.to_owned()));
    let second = || Some(("/sys/fs/cgroup".to_owned(), path("0::")?, ["memory.max", "memory.current", ""]));
    let first = || {
        let names = ["memory.limit_in_bytes", "memory.usage_in_bytes", "total_"];
        Some(("/sys/fs/cgroup/memory".to_owned(), path(":memory:")?, names))
    };
    [second(), first()]
        .into_iter()
        .flatten()
        .filter_map(|(top, path, names)| min_left(Path::new(&top), &path, names))
        .min()
}

/// The minimum left by the group below `top` and its ancestors. `names` are the file names of the limit and of the use,
/// and the prefix of the cache fields.
fn min_left(top: &Path, group: &str, [limit, used, before]: [&str; 3]) -> Option<u64> {
    let left = |folder: &Path| {
        let read = |name: &str| std::fs::read_to_string(folder.join(name)).ok();
        let number = |name: &str| read(name)?.trim().parse::<u64>().ok();
        let kinds = ["inactive_file ", "active_file "].map(|kind| format!("{before}{kind}"));
        let statistics = read("memory.stat").unwrap_or_default();
        let caches = statistics.lines().filter_map(|l| kinds.iter().find_map(|k| l.strip_prefix(k.as_str())));
        let cached: u64 = caches.filter_map(|v| v.trim().parse::<u64>().ok()).sum();
        Some(number(limit)?.saturating_sub(number(used).unwrap_or(0).saturating_sub(cached)))
    };
    let folder = top.join(group.trim_start_matches('/'));
    folder.ancestors().take_while(|f| f.starts_with(top)).filter_map(left).min()
}

/// Address space left by `ulimit -v`, in bytes.
#[cfg(any(target_os = "linux", target_os = "macos"))]
pub(crate) fn address_space() -> Option<u64> {
    let limit = rustix::process::getrlimit(rustix::process::Resource::As).current?;
    Some(limit.saturating_sub(status("VmSize:").unwrap_or(0)))
}

#[cfg(not(any(target_os = "linux", target_os = "macos")))]
pub(crate) fn address_space() -> Option<u64> {
    None
}

/// A size in bytes, as users write it: `800M`, `12G`, `1.5GiB`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes(pub u64);

impl Bytes {
    fn rounded(bytes: u128) -> Self {
        Self(u64::try_from(bytes).unwrap_or(u64::MAX))
    }
}

impl FromStr for Bytes {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("`{text}`: write a size such as 800M, 12G or 1.5GiB");
        let end = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
        let (number, unit) = text.split_at(end);
        let factor = match unit.to_ascii_lowercase().as_str() {
            "" | "b" => 1.0,
            "k" | "kb" => 1e3,
            "m" | "mb" => 1e6,
            "g" | "gb" => 1e9,
            "t" | "tb" => 1e12,
            "kib" => 1024.0,
            "mib" => 1024.0 * 1024.0,
            "gib" => 1024.0 * 1024.0 * 1024.0,
            "tib" => 1024.0 * 1024.0 * 1024.0 * 1024.0,
            _ => return Err(bad()),
        };
        let bytes = number.trim().parse::<f64>().map_err(|_| bad())? * factor;
        if bytes.is_finite() && bytes >= 1.0 { Ok(Self(bytes as u64)) } else { Err(bad()) }
    }
}

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 as f64 {
            b if b < 1e6 => write!(f, "{:.0} kB", b / 1e3),
            b if b < 1e9 => write!(f, "{:.0} MB", b / 1e6),
            b if b < 1e13 => write!(f, "{:.1} GB", b / 1e9),
            b => write!(f, "{:.0} TB", b / 1e12),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn freed_pages_are_kept_unless_the_user_asks_otherwise() {
        // SAFETY: reads one number.
        let delay = || unsafe { libmimalloc_sys::mi_option_get(PURGE_DELAY) };
        if std::env::var_os("MIMALLOC_PURGE_DELAY").is_none() {
            assert_eq!(delay(), 1000, "not the purge delay of this version of mimalloc");
            keep_freed_pages();
            assert_eq!(delay(), -1);
        }
    }

    #[test]
    fn sizes_are_read_and_written_with_units() {
        for (text, bytes) in [("1", 1), ("800M", 800_000_000), ("1.5GiB", 1_610_612_736), ("2 kb", 2000)] {
            assert_eq!(text.parse::<Bytes>(), Ok(Bytes(bytes)), "{text}");
        }
        for bad in ["", "G", "nan", "inf", "-3G", "0", "3X", "1e400G"] {
            assert!(bad.parse::<Bytes>().is_err(), "{bad}");
        }
        assert_eq!(Bytes(12_340_000_000).to_string(), "12.3 GB");
    }

    #[test]
    fn the_tightest_group_limits_and_file_caches_count_as_free() {
        let top = tempfile::tempdir().unwrap();
        let group = top.path().join("job/step");
        std::fs::create_dir_all(&group).unwrap();
        let names = ["memory.max", "memory.current", ""];
        let put = |folder: &Path, file: &str, text: &str| std::fs::write(folder.join(file), text).unwrap();
        put(&group, "memory.max", "max\n");
        assert_eq!(min_left(top.path(), "/job/step", names), None);
        put(&top.path().join("job"), "memory.max", "1000\n");
        put(&top.path().join("job"), "memory.current", "900\n");
        assert_eq!(min_left(top.path(), "/job/step", names), Some(100));
        put(&top.path().join("job"), "memory.stat", "anon 100\ninactive_file 500\nactive_file 200\n");
        assert_eq!(min_left(top.path(), "/job/step", names), Some(800));
    }

    #[test]
    fn a_request_beyond_the_budget_is_refused_by_name() {
        let budget = MemoryBudget::from_bytes(1_000_000_000);
        assert_eq!(budget.check("--size 10", 400), Ok(()));
        let side = usize::MAX;
        let error = budget.check("--size 10", product(&[side, side, side])).unwrap_err().to_string();
        assert!(error.starts_with("--size 10: needs about ") && error.contains("1.0 GB are free"), "{error}");
        assert!(MemoryBudget::now().0 > 0);
    }
}
