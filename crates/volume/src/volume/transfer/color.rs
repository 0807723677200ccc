//! Colour arithmetic on sRGB values in [0, 1]: CIELAB (D65), HSV and the Msh space of Moreland, "Diverging Color
//! Maps for Scientific Visualization" (2009). No files and no transfer functions here.

use std::f64::consts::PI;

/// White point D65 with Y = 1.
const WHITE: [f64; 3] = [0.9505, 1.0, 1.0890];

/// CIELAB values `[L, a, b]` of an sRGB colour; L in [0, 100].
pub fn rgb_to_lab(rgb: [f64; 3]) -> [f64; 3] {
    let [r, g, b] = rgb.map(|v| if v > 0.04045 { ((v + 0.055) / 1.055).powf(2.4) } else { v / 12.92 });
    let xyz = [
        0.4124 * r + 0.3576 * g + 0.1805 * b,
        0.2126 * r + 0.7152 * g + 0.0722 * b,
        0.0193 * r + 0.1192 * g + 0.9505 * b,
    ];
    let curve = |v: f64| if v > 0.008_856 { v.cbrt() } else { 7.787 * v + 16.0 / 116.0 };
    let [x, y, z] = std::array::from_fn(|i| curve(xyz[i] / WHITE[i]));
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// sRGB colour of CIELAB values. Out-of-gamut colours are scaled down by their largest channel, so that the hue is
/// kept, and clipped at zero.
pub fn lab_to_rgb(lab: [f64; 3]) -> [f64; 3] {
    let y = (lab[0] + 16.0) / 116.0;
    let curve = |v: f64| if v.powi(3) > 0.008_856 { v.powi(3) } else { (v - 16.0 / 116.0) / 7.787 };
    let [x, y, z] = [y + lab[1] / 500.0, y, y - lab[2] / 200.0].map(curve);
    let [x, y, z] = [x * WHITE[0], y * WHITE[1], z * WHITE[2]];
    let linear = [
        3.2406 * x - 1.5372 * y - 0.4986 * z,
        -0.9689 * x + 1.8758 * y + 0.0415 * z,
        0.0557 * x - 0.2040 * y + 1.0570 * z,
    ];
    let rgb = linear.map(|v| if v > 0.003_130_8 { 1.055 * v.powf(1.0 / 2.4) - 0.055 } else { 12.92 * v });
    let largest = rgb.iter().fold(1.0_f64, |m, v| m.max(*v));
    rgb.map(|v| (v / largest).max(0.0))
}

/// Hue in [0, 1), saturation and value of an RGB colour.
pub fn rgb_to_hsv([r, g, b]: [f64; 3]) -> [f64; 3] {
    let high = r.max(g).max(b);
    let width = high - r.min(g).min(b);
    if width <= 0.0 {
        return [0.0, 0.0, high];
    }
    let sector = if r >= high {
        (g - b) / width
    } else if g >= high {
        2.0 + (b - r) / width
    } else {
        4.0 + (r - g) / width
    };
    [(sector / 6.0).rem_euclid(1.0), width / high, high]
}

/// RGB colour of hue (any number, one turn is 1), saturation and value.
pub fn hsv_to_rgb([h, s, v]: [f64; 3]) -> [f64; 3] {
    [5.0, 3.0, 1.0].map(|n| {
        let k: f64 = (n + h * 6.0).rem_euclid(6.0);
        v - v * s * k.min(4.0 - k).clamp(0.0, 1.0)
    })
}

/// Mixes in CIELAB.
pub fn mix_lab(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    lab_to_rgb(mix(rgb_to_lab(a), rgb_to_lab(b), t))
}

/// Mixes in HSV; `wrap` takes the shorter way round the hue circle.
pub fn mix_hsv(a: [f64; 3], b: [f64; 3], t: f64, wrap: bool) -> [f64; 3] {
    let (mut a, mut b) = (rgb_to_hsv(a), rgb_to_hsv(b));
    if wrap && (a[0] - b[0]).abs() > 0.5 {
        if a[0] > b[0] {
            a[0] -= 1.0;
        } else {
            b[0] -= 1.0;
        }
    }
    hsv_to_rgb(mix(a, b, t))
}

/// Mixes in Msh, with white in the middle of two distinct saturated colours (Moreland 2009, section 5).
pub fn mix_diverging(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    let (mut a, mut b, mut t) = (rgb_to_msh(a), rgb_to_msh(b), t);
    let turn = (a[2] - b[2]).abs();
    let turn = turn.min(2.0 * PI - turn);
    if a[1] > 0.05 && b[1] > 0.05 && turn > PI / 3.0 {
        let middle = [a[0].max(b[0]).max(88.0), 0.0, 0.0];
        if t < 0.5 {
            b = middle;
            t *= 2.0;
        } else {
            a = middle;
            t = 2.0 * t - 1.0;
        }
    }
    // the hue of a colour without saturation is meaningless; it is set so that the path to it looks straight
    if a[1] < 0.05 && b[1] > 0.05 {
        a[2] = adjusted_hue(b, a[0]);
    } else if b[1] < 0.05 && a[1] > 0.05 {
        b[2] = adjusted_hue(a, b[0]);
    }
    let [m, s, h] = mix(a, b, t);
    lab_to_rgb([m * s.cos(), m * s.sin() * h.cos(), m * s.sin() * h.sin()])
}

/// Magnitude, saturation angle and hue angle.
fn rgb_to_msh(rgb: [f64; 3]) -> [f64; 3] {
    let [l, a, b] = rgb_to_lab(rgb);
    let m = (l * l + a * a + b * b).sqrt();
    let s = if m > 0.001 { (l / m).clamp(-1.0, 1.0).acos() } else { 0.0 };
    let h = if s > 0.001 { b.atan2(a) } else { 0.0 };
    [m, s, h]
}

fn adjusted_hue([m, s, h]: [f64; 3], gray: f64) -> f64 {
    if m >= gray - 0.1 {
        return h;
    }
    let spin = s * (gray * gray - m * m).sqrt() / (m * s.sin());
    if h > -0.3 * PI { h + spin } else { h - spin }
}

fn mix(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    std::array::from_fn(|i| a[i] * (1.0 - t) + b[i] * t)
}

/// The colour of `#rrggbb`.
pub fn parse_hex(text: &str) -> Option<[f32; 3]> {
    let digits = text.strip_prefix('#').filter(|d| d.len() == 6 && d.bytes().all(|b| b.is_ascii_hexdigit()))?;
    let value = u32::from_str_radix(digits, 16).ok()?;
    Some([16, 8, 0].map(|shift| (value >> shift & 255) as f32 / 255.0))
}

/// `#rrggbb`, if the colour has 8 bits per channel exactly.
pub fn exact_hex(color: [f32; 3]) -> Option<String> {
    let [r, g, b] = color.map(|v| (v * 255.0).round() as u8);
    let text = format!("#{r:02x}{g:02x}{b:02x}");
    (parse_hex(&text) == Some(color)).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn known_lab_values() {
        let near = |rgb, lab: [f64; 3]| {
            let got = rgb_to_lab(rgb);
            assert!((0..3).all(|i| (got[i] - lab[i]).abs() < 0.06), "{got:?} {lab:?}");
        };
        near([1.0, 1.0, 1.0], [100.0, 0.0, 0.0]);
        near([1.0, 0.0, 0.0], [53.24, 80.09, 67.20]);
        near([0.0, 0.0, 1.0], [32.30, 79.19, -107.86]);
        near([0.0; 3], [0.0; 3]);
    }

    #[test]
    fn hsv_ways() {
        let (red, blue) = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
        assert_eq!(mix_hsv(red, blue, 0.5, false), [0.0, 1.0, 0.0]);
        assert_eq!(mix_hsv(red, blue, 0.5, true), [1.0, 0.0, 1.0]);
    }

    #[test]
    fn hex() {
        assert_eq!(parse_hex("#ff0080"), Some([1.0, 0.0, 128.0 / 255.0]));
        for bad in ["ff0080", "#ff008", "#ff00800", "#+f0080", "#fg0080", "#ééé", ""] {
            assert_eq!(parse_hex(bad), None, "{bad}");
        }
        assert_eq!(exact_hex([1.0, 0.0, 128.0 / 255.0]).as_deref(), Some("#ff0080"));
        assert_eq!(exact_hex([0.5; 3]), None);
        assert_eq!(exact_hex([f32::NAN; 3]), None);
    }

    proptest! {
        #[test]
        fn spaces_round_trip(rgb in prop::array::uniform3(0.0..=1.0f64)) {
            for back in [lab_to_rgb(rgb_to_lab(rgb)), hsv_to_rgb(rgb_to_hsv(rgb)), mix_diverging(rgb, rgb, 0.3)] {
                for c in 0..3 {
                    prop_assert!((back[c] - rgb[c]).abs() < 2e-3, "{:?} {:?}", back, rgb);
                }
            }
        }

        #[test]
        fn mixes_stay_in_gamut(a in prop::array::uniform3(0.0..=1.0f64), b in prop::array::uniform3(0.0..=1.0f64), t in 0.0..=1.0f64) {
            for mixed in [mix_lab(a, b, t), mix_hsv(a, b, t, true), mix_hsv(a, b, t, false), mix_diverging(a, b, t)] {
                prop_assert!(mixed.iter().all(|v| (-1e-12..=1.0 + 1e-12).contains(v)), "{:?}", mixed);
            }
        }
    }
}
