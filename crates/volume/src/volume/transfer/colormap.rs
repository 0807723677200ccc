//! Named colour maps. The perceptual ones (viridis, cividis, inferno, magma, plasma; all CC0) are sampled at ten
//! points.

use super::bracket;
use super::color::mix_diverging;

/// Names accepted by [`named`].
pub const NAMES: [&str; 8] = ["viridis", "cividis", "inferno", "magma", "plasma", "cool-warm", "black-body", "gray"];

/// Ends of the diverging map of Moreland (2009).
const COOL: [f64; 3] = [0.230, 0.299, 0.754];
const WARM: [f64; 3] = [0.706, 0.016, 0.150];

/// Control points (fraction, sRGB colour) of a colour map; `None` for an unknown name.
pub fn named(name: &str) -> Option<Vec<(f64, [f32; 3])>> {
    let even: &[u32] = match name {
        "viridis" => {
            &[0x440154, 0x482878, 0x3e4989, 0x31688e, 0x26828e, 0x1f9e89, 0x35b779, 0x6ece58, 0xb5de2b, 0xfde725]
        }
        "cividis" => {
            &[0x00204d, 0x00336f, 0x39486b, 0x575c6d, 0x707173, 0x8a8779, 0xa69d75, 0xc4b56c, 0xe4cf5b, 0xffea46]
        }
        "inferno" => {
            &[0x000004, 0x1b0c41, 0x4a0c6b, 0x781c6d, 0xa52c60, 0xcf4446, 0xed6925, 0xfb9b06, 0xf7d13d, 0xfcffa4]
        }
        "magma" => {
            &[0x000004, 0x180f3d, 0x440f76, 0x721f81, 0x9e2f7f, 0xcd4071, 0xf1605d, 0xfd9668, 0xfeca8d, 0xfcfdbf]
        }
        "plasma" => {
            &[0x0d0887, 0x46039f, 0x7201a8, 0x9c179e, 0xbd3786, 0xd8576b, 0xed7953, 0xfb9f3a, 0xfdca26, 0xf0f921]
        }
        "black-body" => &[0x000000, 0x5c0f06, 0xb22313, 0xdd5a14, 0xe8a41f, 0xf2e070, 0xffffff],
        "gray" => &[0x000000, 0xffffff],
        "cool-warm" => {
            let at = |i: u32| f64::from(i) / 32.0;
            return Some((0..=32).map(|i| (at(i), mix_diverging(COOL, WARM, at(i)).map(|v| v as f32))).collect());
        }
        _ => return None,
    };
    let last = (even.len() - 1) as f64;
    let color = |hex: u32| [16, 8, 0].map(|shift| (hex >> shift & 255) as f32 / 255.0);
    Some(even.iter().enumerate().map(|(i, hex)| (i as f64 / last, color(*hex))).collect())
}

/// sRGB colour of a map at a fraction; the end values hold outside [0, 1], and a map without points is black.
pub fn colour_at(map: &[(f64, [f32; 3])], fraction: f64) -> [f32; 3] {
    bracket(map, fraction).map_or([0.0; 3], |(a, b, t)| std::array::from_fn(|c| a[c] + (b[c] - a[c]) * t as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_has_a_map_from_0_to_1() {
        for name in NAMES {
            let map = named(name).unwrap();
            assert_eq!((map[0].0, map[map.len() - 1].0), (0.0, 1.0), "{name}");
            assert!(map.iter().flat_map(|p| p.1).all(|v| (0.0..=1.0).contains(&v)), "{name}");
        }
        assert!(named("jet").is_none());
    }

    /// The table that Moreland published with the paper, every fourth entry.
    #[test]
    fn cool_warm_is_as_published() {
        let published = [
            [59, 76, 192],
            [98, 130, 234],
            [141, 176, 254],
            [184, 208, 249],
            [221, 221, 221],
            [245, 196, 173],
            [244, 154, 123],
            [222, 96, 77],
            [180, 4, 38],
        ];
        let map = named("cool-warm").unwrap();
        for (i, want) in published.into_iter().enumerate() {
            for (got, want) in map[i * 4].1.into_iter().zip(want) {
                assert!((got * 255.0 - want as f32).abs() <= 1.0, "{i}: {got} {want}");
            }
        }
        assert!(map[16].1.iter().all(|v| (v - 0.865).abs() < 5e-4), "{:?}", map[16]);
    }
}
