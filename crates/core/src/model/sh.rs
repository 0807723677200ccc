//! Spherical harmonics on the host, for what segments and edits do with a Gaussian's colour coefficients.
//!
//! Constants of bands 0 and 1 are the nearest single-precision numbers here. Drawing ([`volseggs_kernels::sh`]) uses
//! the digits of the reference rasteriser, which come out one unit in the last place away; both are kept, as
//! a change of either would change the bits of scenes, segments and edits.

use volseggs_kernels::sh::{self, Bands};

/// The constant basis function, `1 / (2 sqrt(pi))`.
pub const C0: f32 = 0.282_094_8;
/// The factor of band 1, `sqrt(3 / 4 pi)`.
pub const C1: f32 = 0.488_602_5;

/// Returns the degrees of the bands of K coefficients beyond the constant one, in the order of the coefficients.
pub fn degrees(k: usize) -> impl Iterator<Item = usize> {
    let (bands, most) = Bands::from_count(k).unwrap_or((Bands::All, 0));
    let step = match bands {
        Bands::All => 1,
        Bands::Even => 2,
    };
    (step..=most).step_by(step)
}

/// The functions of K coefficients at a unit direction, at most 16, in the order and with the signs of 3D Gaussian
/// splatting: those of even bands where K is the number of these.
pub fn basis_of(k: usize, direction: [f32; 3]) -> [f32; 16] {
    match Bands::of_any(k) {
        Bands::All => basis(direction),
        Bands::Even => {
            let mut values = sh::basis(direction, 4, Bands::Even);
            values[0] = C0;
            values
        }
    }
}

/// The 16 functions up to degree 3 at a unit direction, in the order and with the signs of 3D Gaussian splatting.
pub fn basis(direction: [f32; 3]) -> [f32; 16] {
    let [x, y, z] = direction;
    let mut values = sh::basis(direction, 3, Bands::All);
    values[..4].copy_from_slice(&[C0, -C1 * y, C1 * z, -C1 * x]);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_differ_from_those_of_drawing_by_rounding_alone() {
        assert!((C0 - sh::C0).abs() <= f32::EPSILON / 4.0 && (C1 - sh::C1).abs() <= f32::EPSILON / 4.0);
        let direction = [0.48, -0.6, 0.64];
        for (ours, drawn) in basis(direction).into_iter().zip(sh::basis(direction, 3, Bands::All)) {
            assert!((ours - drawn).abs() < 1e-7, "{ours} {drawn}");
        }
    }
}
