//! Adding floats that many units share: by the device's own float atomics, or by compare and exchange of their bits.

use burn_cubecl::cubecl;
use burn_cubecl::cubecl::prelude::*;

/// How a float is added to memory that others add to as well.
#[cube]
pub(crate) trait AddF32: Send + Sync + 'static {
    /// What the memory holds: f32, or its bits as u32.
    type Storage: Numeric;
    fn add(target: &Atomic<Self::Storage>, value: f32);
}

/// The device adds floats.
#[derive(CubeType)]
pub(crate) struct Native;

/// Compare and exchange until nobody came between.
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
