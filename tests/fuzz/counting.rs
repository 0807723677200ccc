//! An allocator that counts what a thread holds, and stops a thread that requests too much.
//!
//! Only threads that called [`watch`] are counted. A thread over its cap is put to sleep forever inside the allocator:
//! it cannot unwind from there, a null pointer would end the whole process, and the memory itself might not be
//! available. Whoever watches the [`Slot`] notices it and continues with another thread.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicI64, Ordering::Relaxed};
use std::time::Duration;

/// The system's allocator, counted.
pub struct Counting;

/// Bytes held by one thread.
#[derive(Debug, Default)]
pub struct Slot {
    live: AtomicI64,
    peak: AtomicI64,
    cap: AtomicI64,
    refused: AtomicI64,
}

thread_local! {
    static SLOT: Cell<Option<&'static Slot>> = const { Cell::new(None) };
}

/// Counts this thread in `slot` from now on, and puts it to sleep if it would hold more than `cap` bytes.
pub fn watch(slot: &'static Slot, cap: i64) {
    slot.cap.store(cap, Relaxed);
    slot.refused.store(0, Relaxed);
    slot.reset();
    SLOT.set(Some(slot));
}

impl Slot {
    /// Restarts counting at zero.
    pub fn reset(&self) {
        self.live.store(0, Relaxed);
        self.peak.store(0, Relaxed);
    }

    /// Returns the maximum number of bytes held at once since [`Slot::reset`].
    pub fn peak(&self) -> i64 {
        self.peak.load(Relaxed)
    }

    /// Returns the bytes that the thread requested when it was put to sleep; 0 if it was not.
    pub fn refused(&self) -> i64 {
        self.refused.load(Relaxed)
    }

    fn grow(&self, bytes: i64) {
        let live = self.live.fetch_add(bytes, Relaxed) + bytes;
        self.peak.fetch_max(live, Relaxed);
        if live > self.cap.load(Relaxed) {
            self.refused.store(bytes.max(1), Relaxed);
            loop {
                std::thread::sleep(Duration::from_secs(3600));
            }
        }
    }
}

fn grow(bytes: usize) {
    if let Ok(Some(slot)) = SLOT.try_with(Cell::get) {
        slot.grow(i64::try_from(bytes).unwrap_or(i64::MAX / 2));
    }
}

fn shrink(bytes: usize) {
    if let Ok(Some(slot)) = SLOT.try_with(Cell::get) {
        slot.live.fetch_sub(i64::try_from(bytes).unwrap_or(0), Relaxed);
    }
}

// SAFETY: every call is passed on unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: guaranteed by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: guaranteed by the caller.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        shrink(layout.size());
        // SAFETY: guaranteed by the caller.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        grow(size.saturating_sub(layout.size()));
        shrink(layout.size().saturating_sub(size));
        // SAFETY: guaranteed by the caller.
        unsafe { System.realloc(pointer, layout, size) }
    }
}
