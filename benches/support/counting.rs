//! The program's allocator, counting the allocations made.

use std::alloc::{GlobalAlloc, Layout};
use std::sync::atomic::{AtomicU64, Ordering};

/// Allocations of at least this many bytes are also counted separately.
const LARGE: usize = 1 << 20;

static CALLS: AtomicU64 = AtomicU64::new(0);
static LARGE_CALLS: AtomicU64 = AtomicU64::new(0);
static BYTES: AtomicU64 = AtomicU64::new(0);

/// mimalloc, as in the program.
pub struct Counting;

/// Number and total size of allocations.
#[derive(Clone, Copy)]
pub struct Count {
    calls: u64,
    large: u64,
    bytes: u64,
}

/// Returns the allocations since the program started.
pub fn count() -> Count {
    let read = |v: &AtomicU64| v.load(Ordering::Relaxed);
    Count { calls: read(&CALLS), large: read(&LARGE_CALLS), bytes: read(&BYTES) }
}

impl std::ops::Sub for Count {
    type Output = Self;
    fn sub(self, before: Self) -> Self {
        Self { calls: self.calls - before.calls, large: self.large - before.large, bytes: self.bytes - before.bytes }
    }
}

impl std::fmt::Display for Count {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, {} of them of 1 MiB or more, {} MiB in all", self.calls, self.large, self.bytes >> 20)
    }
}

fn note(bytes: usize) {
    CALLS.fetch_add(1, Ordering::Relaxed);
    LARGE_CALLS.fetch_add(u64::from(bytes >= LARGE), Ordering::Relaxed);
    BYTES.fetch_add(bytes as u64, Ordering::Relaxed);
}

// SAFETY: every call goes to mimalloc unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        unsafe { mimalloc::MiMalloc.alloc(layout) }
    }
    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        unsafe { mimalloc::MiMalloc.dealloc(memory, layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        unsafe { mimalloc::MiMalloc.alloc_zeroed(layout) }
    }
    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note(size);
        unsafe { mimalloc::MiMalloc.realloc(memory, layout, size) }
    }
}
