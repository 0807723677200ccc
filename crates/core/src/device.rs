//! Devices by name. This is the only file that names a backend.

use burn::tensor::Device;
use std::fmt;
use std::str::FromStr;

/// A device that can be selected on the command line.
///
/// ```
/// use volseggs_core::device::DeviceName;
/// let cpu: DeviceName = "flex".parse()?;
/// let device = cpu.open()?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceName {
    /// burn's own CPU backend.
    Flex,
    /// The CPU backend on the `ndarray` crate.
    NdArray,
    /// A GPU through wgpu: Vulkan, Metal, DX12, WebGPU.
    Wgpu,
    /// An NVIDIA GPU through CUDA.
    Cuda,
    /// LibTorch on the CPU.
    Tch,
}

/// Why a device cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// No such name, or not compiled in.
    #[error("no device \"{0}\" in this build; available: {list}", list = DeviceName::all().iter().map(ToString::to_string).collect::<Vec<_>>().join(", "))]
    Unknown(String),
    /// Compiled in, but missing on this machine.
    #[error(
        "device \"{name}\" does not start: {reason}. `volseggs doctor` lists the devices; --device flex always works"
    )]
    Absent {
        /// The device.
        name: DeviceName,
        /// What the runtime reports.
        reason: String,
    },
}

impl DeviceName {
    /// The devices compiled in, the default first.
    pub fn all() -> Vec<Self> {
        vec![
            #[cfg(feature = "flex")]
            Self::Flex,
            #[cfg(feature = "ndarray")]
            Self::NdArray,
            #[cfg(feature = "wgpu")]
            Self::Wgpu,
            #[cfg(feature = "cuda")]
            Self::Cuda,
            #[cfg(feature = "tch")]
            Self::Tch,
        ]
    }

    /// The first compiled-in device that computes on the CPU.
    pub fn cpu() -> Option<Self> {
        Self::all().into_iter().find(|name| name.is_cpu())
    }

    /// Whether it computes on the CPU.
    pub fn is_cpu(self) -> bool {
        matches!(self, Self::Flex | Self::NdArray | Self::Tch)
    }

    /// All devices that can be compiled in.
    pub fn every() -> [Self; 5] {
        [Self::Flex, Self::NdArray, Self::Wgpu, Self::Cuda, Self::Tch]
    }

    /// A one-line description.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Flex => "CPU, burn-flex; splatting and field by our own SIMD kernels on all cores",
            Self::NdArray => "CPU, burn-ndarray; the same kernels, tensor operations by ndarray",
            Self::Wgpu => "GPU through wgpu (Vulkan, Metal, DX12); the kernels in CubeCL, compiled when first used",
            Self::Cuda => "NVIDIA GPU through CUDA; the same CubeCL kernels",
            Self::Tch => "CPU, LibTorch; our SIMD kernels, tensor operations by LibTorch",
        }
    }

    /// Opens the device.
    ///
    /// # Errors
    /// If the backend is not compiled in, or the machine has no such device.
    #[allow(deprecated)] // burn deprecates ndarray and LibTorch in favour of its newer backends; this crate keeps them
    pub fn open(self) -> Result<Device, DeviceError> {
        match self {
            #[cfg(feature = "flex")]
            Self::Flex => Ok(Device::flex()),
            #[cfg(feature = "ndarray")]
            Self::NdArray => Ok(Device::ndarray()),
            #[cfg(feature = "wgpu")]
            Self::Wgpu => wgpu(),
            #[cfg(feature = "cuda")]
            Self::Cuda => cuda(),
            #[cfg(feature = "tch")]
            Self::Tch => Ok(Device::libtorch()),
            #[allow(unreachable_patterns)]
            other => Err(DeviceError::Unknown(other.to_string())),
        }
    }
}

/// The adapter that wgpu prefers, or the one named by `CUBECL_WGPU_DEFAULT_DEVICE`; started once.
#[cfg(feature = "wgpu")]
fn wgpu() -> Result<Device, DeviceError> {
    static STARTED: std::sync::OnceLock<Result<Device, String>> = std::sync::OnceLock::new();
    let started = STARTED.get_or_init(|| Device::wgpu_options().init().map_err(|e| e.to_string()));
    started.clone().map_err(|reason| DeviceError::Absent { name: DeviceName::Wgpu, reason })
}

/// The first CUDA device. The runtime panics if there is none.
#[cfg(feature = "cuda")]
fn cuda() -> Result<Device, DeviceError> {
    let start = || {
        let device = Device::cuda(0);
        burn::tensor::Tensor::<1>::zeros([1], &device).into_data();
        device
    };
    std::panic::catch_unwind(start)
        .map_err(|_| DeviceError::Absent { name: DeviceName::Cuda, reason: "no CUDA device or driver".into() })
}

/// Opens a compiled-in device for `volseggs_testing::on_every_device`; returns `None`, after reporting it, if it does
/// not start.
#[cfg(test)]
pub(crate) fn open_to_test(name: &str) -> Option<Device> {
    let device = name.parse().and_then(DeviceName::open);
    device.map_err(|error| volseggs_testing::skip_device(name, &error.to_string())).ok()
}

/// Whether the device runs asynchronously, so that reading a value back waits for all queued work.
pub fn runs_ahead(device: &Device) -> bool {
    #[cfg(any(feature = "wgpu", feature = "cuda"))]
    return volseggs_kernels::is_gpu(device);
    #[cfg(not(any(feature = "wgpu", feature = "cuda")))]
    {
        let _ = device;
        false
    }
}

/// The largest buffer that a GPU can bind, in bytes; `None` for devices in host memory.
pub fn largest_buffer(device: &Device) -> Option<u64> {
    #[cfg(any(feature = "wgpu", feature = "cuda"))]
    return volseggs_kernels::gpu_paths(device).map(|paths| paths.max_binding);
    #[cfg(not(any(feature = "wgpu", feature = "cuda")))]
    {
        let _ = device;
        None
    }
}

impl fmt::Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Flex => "flex",
            Self::NdArray => "ndarray",
            Self::Wgpu => "wgpu",
            Self::Cuda => "cuda",
            Self::Tch => "tch",
        })
    }
}

impl FromStr for DeviceName {
    type Err = DeviceError;

    fn from_str(name: &str) -> Result<Self, DeviceError> {
        Self::all().into_iter().find(|d| d.to_string() == name).ok_or_else(|| DeviceError::Unknown(name.to_owned()))
    }
}
