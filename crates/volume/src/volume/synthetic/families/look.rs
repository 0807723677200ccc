//! How a scene looks: its colours, the bands of values that bodies of one material have, the transfer function that
//! shows them, the light.

use super::draw::Draw;
use super::scene::BodyScene;
use crate::volume::transfer::color::hsv_to_rgb;
use crate::volume::transfer::{DEFAULT_UNIT_LENGTH, Shading, TransferFunction};

/// Length in which opacity accrues, in that of the box.
const UNIT: f64 = 2.0 * DEFAULT_UNIT_LENGTH;

/// The opacity per unit that adds up to `whole` over a length of the box.
pub(super) fn over(length: f64, whole: f64) -> f64 {
    1.0 - (1.0 - whole).powf(UNIT / length)
}

/// What bodies are made of: a band of values with a colour and an opacity.
#[derive(Clone)]
pub(super) struct BodyMaterial {
    /// sRGB at the low end of the band and at the high one.
    pub colours: [[f32; 3]; 2],
    /// Opacity per hundredth of the box's side at both ends.
    pub opacities: [f32; 2],
    /// Values from 0 (empty) to 1; those of the other side are negative.
    pub low: f64,
    /// The end of the band.
    pub high: f64,
    /// 1, or -1 for values below the empty middle.
    pub side: f64,
    /// Opacity rises with the value from almost nothing, so that a body can fade; else the band begins at once.
    pub fades: bool,
}

/// Below this value all is transparent.
const EMPTY: f64 = 0.06;
/// Width of all bands but the highest, and of their edges.
const BAND: f64 = 0.035;
const EDGE: f64 = 0.02;

/// As many colours of distinct hues, sRGB.
fn colours(draw: &mut Draw, count: usize) -> Vec<[f32; 3]> {
    let first = draw.range(0.0, 1.0);
    let colour = |k: usize, draw: &mut Draw| {
        let hue = first + (k as f64 + draw.range(-0.12, 0.12)) / count.max(3) as f64;
        // yellows and greens look brighter than others of the same value
        hex(hsv_to_rgb([hue.rem_euclid(1.0), draw.range(0.55, 0.9), draw.range(0.62, 0.9)]))
    };
    let mut out: Vec<[f32; 3]> = (0..count).map(|k| colour(k, draw)).collect();
    for i in (1..out.len()).rev() {
        let j = draw.whole(0, i);
        out.swap(i, j);
    }
    out
}

/// The nearest colour of 8 bits.
fn hex(colour: [f64; 3]) -> [f32; 3] {
    colour.map(|c| ((c * 255.0).round() / 255.0) as f32)
}

/// Materials of these opacities whose bands lie one above the other, the first one lowest. A body of a higher band
/// passes through those below in its soft edge: a surface layer of another colour, the farther off the farther the
/// bands are from each other.
pub(super) fn rising(draw: &mut Draw, opacities: &[f64]) -> Vec<BodyMaterial> {
    let count = opacities.len();
    let between = draw.range(BAND + 2.0 * EDGE, 0.17);
    let material = |(k, (colour, opacity)): (usize, ([f32; 3], &f64))| {
        let low = if count == 1 { 0.4 } else { 0.82 - between * (count - 1 - k) as f64 };
        let high = if k + 1 == count { 1.0 } else { low + BAND };
        BodyMaterial { colours: [colour; 2], opacities: [*opacity as f32; 2], low, high, side: 1.0, fades: count == 1 }
    };
    colours(draw, count).into_iter().zip(opacities).enumerate().map(material).collect()
}

/// Two materials on both sides of an empty middle; neither passes through the other.
pub(super) fn two_sided(draw: &mut Draw, opacities: [f64; 2]) -> Vec<BodyMaterial> {
    let one = |colour, opacity: f64, side| BodyMaterial {
        colours: [colour; 2],
        opacities: [opacity as f32; 2],
        low: 0.4,
        high: 1.0,
        side,
        fades: true,
    };
    let colours = colours(draw, 2);
    vec![one(colours[0], opacities[0], 1.0), one(colours[1], opacities[1], -1.0)]
}

/// `count` materials of similar opacity, on both sides or rising, as drawn; and whether they are on both sides.
pub(super) fn alike(draw: &mut Draw, count: usize, opacity: [f64; 2]) -> (Vec<BodyMaterial>, bool) {
    let one = |draw: &mut Draw| draw.range(opacity[0], opacity[1]);
    if count == 2 && draw.chance(0.6) {
        let both = [one(draw), one(draw)];
        return (two_sided(draw, both), true);
    }
    let mut opacities: Vec<f64> = (0..count).map(|_| one(draw)).collect();
    // what is passed on the way up should be faint
    opacities.sort_by(f64::total_cmp);
    (rising(draw, &opacities), false)
}

/// The light of a scene: of four seeds in a row each has another kind, of strengths as drawn. Kinds: soft with
/// highlights, dark rims with highlights, flat, and matt.
pub(super) fn light(draw: &mut Draw, family: u64, seed: u64) -> Shading {
    let (ambient, specular, power) = match seed.wrapping_add(family) % 4 {
        0 => (draw.range(0.4, 0.5), draw.range(0.2, 0.35), draw.range(20.0, 40.0)),
        1 => (draw.range(0.05, 0.15), draw.range(0.3, 0.6), draw.range(30.0, 60.0)),
        2 => (draw.range(0.75, 0.9), 0.0, 20.0),
        _ => (draw.range(0.25, 0.35), draw.range(0.0, 0.1), draw.range(10.0, 20.0)),
    };
    let round = |v: f64| ((v * 100.0).round() / 100.0) as f32;
    Shading {
        enabled: true,
        ambient: round(ambient),
        diffuse: round(1.0 - ambient),
        specular: round(specular),
        power: round(power),
    }
}

/// Control points of one side of the value axis, by value from 0 up.
struct RampSide {
    colours: Vec<(f64, [f32; 3])>,
    opacity: Vec<(f64, f32)>,
}

fn side(materials: &[BodyMaterial], sign: f64) -> RampSide {
    let mut bands: Vec<&BodyMaterial> = materials.iter().filter(|m| m.side == sign).collect();
    bands.sort_by(|a, b| a.low.total_cmp(&b.low));
    let mut out = RampSide { colours: Vec::new(), opacity: vec![(0.0, 0.0)] };
    for (k, band) in bands.iter().enumerate() {
        let last = k + 1 == bands.len();
        let start = if band.fades { EMPTY } else { band.low - EDGE };
        out.opacity.extend([(start, 0.0), (band.low, band.opacities[0]), (band.high, band.opacities[1])]);
        if !last {
            out.opacity.push((band.high + EDGE, 0.0));
        }
        // one colour ends half-way to the next band
        let from = if k == 0 { 0.0 } else { 0.5 * (bands[k - 1].high + band.low) };
        let to = if last { 1.0 } else { 0.5 * (band.high + bands[k + 1].low) };
        let [low, high] = band.colours;
        out.colours.extend([(from, low), (band.low, low), (band.high, high), (to, high)]);
    }
    out
}

/// The transfer function that shows a scene.
pub(super) fn transfer_function(scene: &BodyScene, name: String) -> TransferFunction {
    let above = side(&scene.materials, 1.0);
    let (mut colors, mut opacity) = (above.colours, above.opacity);
    if scene.two_sided {
        let below = side(&scene.materials, -1.0);
        colors = mirrored(below.colours, colors);
        opacity = mirrored(below.opacity, opacity);
    }
    TransferFunction {
        name,
        range: Some([0.0, 1.0]),
        colors,
        opacity,
        unit_length: DEFAULT_UNIT_LENGTH,
        shading: scene.shading,
        segments: Vec::new(),
    }
}

/// Points of both sides by fraction: `below` from the middle down, `above` from the middle up.
fn mirrored<T>(below: Vec<(f64, T)>, above: Vec<(f64, T)>) -> Vec<(f64, T)> {
    let below = below.into_iter().rev().map(|(v, value)| (0.5 - 0.5 * v, value));
    below.chain(above.into_iter().map(|(v, value)| (0.5 + 0.5 * v, value))).collect()
}
