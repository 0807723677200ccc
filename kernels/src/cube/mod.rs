//! Code shared by the GPU kernels of all ops: buffers, launch sizes, and the parallel building blocks scan, sort,
//! reduction and matrix product. One CubeCL source serves wgpu (Vulkan, Metal, DX12, WebGPU) and CUDA.
//!
//! Nothing here needs plane (warp, subgroup) operations or 64-bit numbers. Sums across units are reduced in shared
//! memory in a fixed order; only the field's scatter uses float atomics, see [`atomic`].

pub(crate) mod atomic;
pub(crate) mod gemm;
pub(crate) mod path;
pub(crate) mod reduce;
pub(crate) mod scan;
pub(crate) mod sort;
pub(crate) mod vector;

pub use path::{GpuPaths, gpu_paths, is_gpu};

use burn::tensor::{DType, Shape};
use burn_cubecl::cubecl::server::Handle;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::ops::numeric::empty_device_contiguous_dtype;
use prelude::*;

/// What every file of GPU kernels uses of the kernel language and of its backend.
pub(crate) mod prelude {
    pub(crate) use burn::backend::tensor::FloatTensor;
    pub(crate) use burn_cubecl::CubeBackend;
    pub(crate) use burn_cubecl::cubecl::{self, client::Client, prelude::*};
    pub(crate) use burn_cubecl::tensor::CubeTensor;
}

/// Default number of units per cube.
pub(crate) const UNITS: u32 = 256;

/// Returns the cube count for `n` units at `per_cube` units per cube, spread over two dimensions because one holds at
/// most 65,535.
pub(crate) fn cubes(n: usize, per_cube: u32) -> CubeCount {
    const ROW: u32 = 32_768;
    let count = (n as u64).div_ceil(u64::from(per_cube)).max(1) as u32;
    if count <= ROW { CubeCount::Static(count, 1, 1) } else { CubeCount::Static(ROW, count.div_ceil(ROW), 1) }
}

/// Returns the number of cubes that a launch of this size starts, at least the number requested.
pub(crate) fn launched(count: &CubeCount) -> usize {
    match count {
        CubeCount::Static(x, y, z) => *x as usize * *y as usize * *z as usize,
        CubeCount::Dynamic(_) => unreachable!("sizes are known on the host"),
    }
}

/// A buffer of words (f32 or u32) on the device, without a shape.
#[derive(Clone, Debug)]
pub(crate) struct Words {
    handle: Handle,
    len: usize,
}

impl Words {
    /// Allocates `len` uninitialised words; at least one, as an empty buffer cannot be bound.
    pub(crate) fn empty(client: &Client, len: usize) -> Self {
        let len = len.max(1);
        Self { handle: client.empty(4 * len), len }
    }

    pub(crate) fn f32s(client: &Client, values: &[f32]) -> Self {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_ne_bytes()).collect();
        Self { handle: client.create_from_slice(&bytes), len: values.len() }
    }

    pub(crate) fn u32s(client: &Client, values: &[u32]) -> Self {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_ne_bytes()).collect();
        Self { handle: client.create_from_slice(&bytes), len: values.len() }
    }

    /// Wraps the memory of a row-major tensor.
    pub(crate) fn of(tensor: &CubeTensor) -> Self {
        Self { handle: tensor.handle.clone(), len: tensor.meta.shape().num_elements() }
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    pub(crate) fn arg(&self) -> BufferArg {
        // SAFETY: `len` words were allocated for the handle when it was made.
        unsafe { BufferArg::from_raw_parts(self.handle.clone(), self.len) }
    }

    /// Reads the words to the host; waits for the device.
    pub(crate) fn read(&self, client: &Client) -> Vec<u32> {
        to_words(&client.read_one_unchecked(self.handle.clone()))
    }

    /// Reads one word to the host; waits for the device.
    pub(crate) fn read_at(&self, client: &Client, index: usize) -> u32 {
        let (before, after) = (4 * index as u64, 4 * (self.len - index - 1) as u64);
        let word = self.handle.clone().offset_start(before).offset_end(after);
        to_words(&client.read_one_unchecked(word))[0]
    }
}

fn to_words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|b| u32::from_ne_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// Returns an uninitialised f32 tensor on the device of `like`.
pub(crate) fn empty_f32(like: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    empty_device_contiguous_dtype(like.client.clone(), like.device.clone(), shape.into(), DType::F32)
}

/// Returns an uninitialised i32 tensor on the device of `like`.
pub(crate) fn empty_i32(like: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    empty_device_contiguous_dtype(like.client.clone(), like.device.clone(), shape.into(), DType::I32)
}

/// Returns the tensor in row-major order, as the kernels read it.
pub(crate) fn rows(tensor: CubeTensor) -> CubeTensor {
    assert_eq!(tensor.dtype, DType::F32, "the kernels take f32 tensors");
    into_contiguous(tensor)
}

/// Returns a kernel argument for a tensor that the caller keeps.
pub(crate) fn arg(tensor: &CubeTensor) -> BufferArg {
    tensor.clone().into_buffer_arg()
}

/// Returns false for NaN and infinities, tested on their bits: shading languages need not honour comparisons with NaN.
#[cube]
pub(crate) fn is_finite(x: f32) -> bool {
    (u32::reinterpret(x) & 0x7F80_0000u32) != 0x7F80_0000u32
}
