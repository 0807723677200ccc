//! One test a device.

use crate::need::{Need, skip};

/// Says that the running test is skipped because device `name` does not start, for the reason `why`; the caller then
/// returns.
///
/// # Panics
/// If the device is one of the CPU, which every machine has, and as [`skip`].
pub fn skip_device(name: &str, why: &str) {
    let need = match name {
        "wgpu" => Need::Gpu,
        "cuda" => Need::Cuda,
        _ => panic!("device {name} does not start: {why}"),
    };
    skip(need, &format!("device {name} does not start: {why}"));
}

/// Makes each named function `fn(device)` a test on every device that is compiled in, called `FUNCTION::DEVICE`, so that a
/// failure names its device. `open` is a path to a function from a device's name to `Option<device>`, which has said why
/// if there is none (see [`skip_device`]); the calling crate has features of the devices' names.
#[macro_export]
macro_rules! on_every_device {
    ($open:path => $($test:ident),+ $(,)?) => {
        $crate::on_devices!($open => [flex "flex", ndarray "ndarray", tch "tch", wgpu "wgpu", cuda "cuda"] $($test)+);
    };
}

/// As [`on_every_device`], on the devices of the CPU alone, whose kernels are the same and promise the same bits.
#[macro_export]
macro_rules! on_every_cpu_device {
    ($open:path => $($test:ident),+ $(,)?) => {
        $crate::on_devices!($open => [flex "flex", ndarray "ndarray", tch "tch"] $($test)+);
    };
}

/// As [`on_every_device`], on GPUs alone.
#[macro_export]
macro_rules! on_every_gpu {
    ($open:path => $($test:ident),+ $(,)?) => {
        $crate::on_devices!($open => [wgpu "wgpu", cuda "cuda"] $($test)+);
    };
}

/// As [`on_every_device`], on the listed devices; each is given as an identifier and as the feature of the same name.
#[macro_export]
macro_rules! on_devices {
    ($open:path => $devices:tt $($test:ident)+) => {
        $( $crate::on_devices!(@test $open, $test, $devices); )+
    };
    (@test $open:path, $test:ident, [$($name:ident $text:literal),+]) => {
        mod $test {
            $(
                #[cfg(feature = $text)]
                #[test]
                fn $name() {
                    if let Some(device) = $open($text) {
                        super::$test(device);
                    }
                }
            )+
        }
    };
}

#[cfg(test)]
mod tests {
    #[test]
    #[should_panic(expected = "device flex does not start")]
    fn a_cpu_device_is_never_skipped() {
        super::skip_device("flex", "a made-up reason");
    }
}
