//! Atomic addition to floats shared by many units: by the device's own float atomics, or by compare-and-exchange of
//! their bits.

use crate::cube::prelude::*;

/// Addition of a float to memory that other units also add to.
#[cube]
pub(crate) trait AddF32: Send + Sync + 'static {
    /// Element type of the memory: f32, or its bits as u32.
    type Storage: Numeric;
    fn add(target: &Atomic<Self::Storage>, value: f32);
}

/// Uses the device's float atomics.
#[derive(CubeType)]
pub(crate) struct Native;

/// Repeats compare-and-exchange until no other unit has intervened.
#[derive(CubeType)]
pub(crate) struct Exchange;

#[cube]
impl AddF32 for Native {
    type Storage = f32;
    fn add(target: &Atomic<f32>, value: f32) {
        Atomic::fetch_add(target, value);
    }
}

#[cube]
impl AddF32 for Exchange {
    type Storage = u32;
    fn add(target: &Atomic<u32>, value: f32) {
        let mut old = Atomic::load(target);
        let mut done = false;
        while !done {
            let new = u32::reinterpret(f32::reinterpret(old) + value);
            let got = Atomic::compare_exchange_weak(target, old, new);
            if got == old {
                done = true;
            } else {
                old = got;
            }
        }
    }
}
