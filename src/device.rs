//! Devices by name. The only file that names a backend.

use burn::tensor::Device;
use std::fmt;
use std::str::FromStr;

/// A device that can be asked for on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceName {
    /// burn's own CPU backend.
    Flex,
    /// The CPU backend on the `ndarray` crate.
    NdArray,
}

/// A device that is not there.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no device \"{0}\" in this build; there is {list}", list = DeviceName::all().iter().map(ToString::to_string).collect::<Vec<_>>().join(", "))]
pub struct UnknownDevice(String);

impl DeviceName {
    /// The devices compiled in, the default first.
    pub fn all() -> Vec<Self> {
        vec![
            #[cfg(feature = "flex")]
            Self::Flex,
            #[cfg(feature = "ndarray")]
            Self::NdArray,
        ]
    }

    /// What it is, in a line.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Flex => "CPU, burn-flex; splatting and field by our own SIMD kernels on all cores",
            Self::NdArray => "CPU, burn-ndarray; the same kernels, tensor operations by ndarray",
        }
    }

    /// Opens the device.
    ///
    /// # Errors
    /// If the backend is not compiled in.
    #[allow(deprecated)] // burn deprecates ndarray in favour of flex; we keep both
    pub fn open(self) -> Result<Device, UnknownDevice> {
        match self {
            #[cfg(feature = "flex")]
            Self::Flex => Ok(Device::flex()),
            #[cfg(feature = "ndarray")]
            Self::NdArray => Ok(Device::ndarray()),
            #[allow(unreachable_patterns)]
            other => Err(UnknownDevice(other.to_string())),
        }
    }
}

impl fmt::Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Flex => "flex",
            Self::NdArray => "ndarray",
        })
    }
}

impl FromStr for DeviceName {
    type Err = UnknownDevice;

    fn from_str(name: &str) -> Result<Self, UnknownDevice> {
        Self::all().into_iter().find(|d| d.to_string() == name).ok_or_else(|| UnknownDevice(name.to_owned()))
    }
}
