//! Five plumes that rise from the floor, wobble, mushroom, and lean together near the top. Each has its own peak value,
//! so that a transfer function can distinguish them by colour; every plume has the same thin halo.

use super::field::{P3, ellipsoid, lerp, smooth_max, smooth_min, step};

/// Segment names by label.
pub(super) const NAMES: [&str; 5] = ["plume-1", "plume-2", "plume-3", "plume-4", "plume-5"];

/// Height of the nozzles.
const FLOOR: f64 = -0.84;
/// Heads start this high and rise by `RISE` per unit of plume time.
const HEAD_START: f64 = -0.56;
const RISE: f64 = 1.18;
/// Value of the common halo, and how far it extends from a plume's surface.
const HALO: f64 = 0.16;
const HALO_REACH: f64 = 0.075;
/// The last part of a plume's value, which rises slowly inside it and keeps the gradient above zero for shading.
const HEART: f64 = 0.04;
/// Depth at which a plume reaches its peak value.
const HEART_DEPTH: f64 = 0.11;
/// Upper bound on the magnitude of [`turbulence`].
const TURBULENCE_BOUND: f64 = 1.2;

/// The properties in which plumes differ.
struct Plume {
    /// Nozzle position (x, y).
    nozzle: [f64; 2],
    /// Peak value.
    peak: f64,
    /// Head start in plume time.
    lead: f64,
    /// Phase of its wobble.
    phase: f64,
}

const PLUMES: [Plume; 5] = [
    Plume { nozzle: [0.56, 0.05], peak: 0.44, lead: 0.23, phase: 0.0 },
    Plume { nozzle: [0.13, 0.55], peak: 0.57, lead: 0.08, phase: 1.9 },
    Plume { nozzle: [-0.48, 0.32], peak: 0.70, lead: 0.17, phase: 3.7 },
    Plume { nozzle: [-0.40, -0.42], peak: 0.83, lead: 0.02, phase: 5.1 },
    Plume { nozzle: [0.20, -0.54], peak: 0.96, lead: 0.12, phase: 2.6 },
];

/// A plume at one time.
struct Head {
    centre: P3,
    radius: f64,
}

/// The plumes at one time.
pub(super) struct JetsFrame {
    t: f64,
    heads: [Head; 5],
}

/// The plumes at one time and one height.
pub(super) struct JetsSlice<'a> {
    frame: &'a JetsFrame,
    z: f64,
    /// Per plume: centre of the stem at the nearest height it reaches, offset above or below that height, radius.
    stems: [([f64; 2], f64, f64); 5],
}

/// Centre of a plume's stem at the height `z`: upright at the nozzle, leaning in and wobbling higher up.
fn centre(plume: &Plume, z: f64, t: f64) -> [f64; 2] {
    let height = ((z - FLOOR) / (1.0 - FLOOR)).clamp(0.0, 1.0);
    let together = 0.08 + 0.46 * step((t - 0.35) / 0.65);
    let lean = 1.0 - together * step(height / 0.85);
    let sway = 0.18 * height;
    let (w, f) = (3.6 * t, plume.phase);
    [
        plume.nozzle[0] * lean + sway * ((4.3 * z - w + f).sin() + 0.35 * (9.1 * z - 1.7 * w + 2.3 * f).sin()),
        plume.nozzle[1] * lean + sway * ((3.9 * z - w + 1.6 * f).cos() + 0.35 * (8.3 * z - 1.5 * w + f).cos()),
    ]
}

/// Turbulence of mean about 0 and magnitude at most [`TURBULENCE_BOUND`], carried upwards with the plumes.
fn turbulence(p: P3, t: f64, phase: f64) -> f64 {
    let [x, y, z] = [p[0], p[1], p[2] - 0.8 * t];
    let warp = 1.3 * (4.1 * z + 2.0 * t + phase).sin();
    let coarse = (8.7 * x + warp + phase).sin() * (8.1 * y - warp + 0.7 * phase).sin() + (9.9 * z + warp).sin();
    let fine = (19.0 * x + 2.0 * coarse - phase).sin() + (17.0 * y + 18.0 * z + coarse).sin();
    0.36 * coarse + 0.24 * fine
}

impl JetsFrame {
    pub(super) fn new(t: f64) -> Self {
        let heads = PLUMES.each_ref().map(|plume| {
            let own = 0.82 * t + plume.lead;
            let z = HEAD_START + RISE * own;
            let [x, y] = centre(plume, z, t);
            Head { centre: [x, y, z], radius: lerp(0.16, 0.27, step(own * 1.05)) }
        });
        Self { t, heads }
    }

    pub(super) fn slice(&self, z: f64) -> JetsSlice<'_> {
        let stems = std::array::from_fn(|k| {
            let (plume, head) = (&PLUMES[k], &self.heads[k]);
            let near = z.clamp(FLOOR, head.centre[2]);
            let bulge = 1.0 + 0.24 * (15.0 * (near - 0.9 * self.t) + plume.phase).sin();
            let flare = 0.035 * (-(near - FLOOR) / 0.12).exp();
            (centre(plume, near, self.t), z - near, (0.070 + 0.040 * (near - FLOOR)) * bulge + flare)
        });
        JetsSlice { frame: self, z, stems }
    }
}

impl JetsSlice<'_> {
    /// Value and label at one point of the slice, before the window of the box.
    pub(super) fn at(&self, x: f64, y: f64) -> (f64, u16) {
        let mut value = 0.0;
        let (mut highest, mut label) = (0.0, 0);
        for k in 0..PLUMES.len() {
            let own = self.plume(k, x, y);
            if own <= 0.0 {
                continue;
            }
            value = smooth_max(value, own, 0.03 * step(own / 0.05));
            if own > highest {
                (highest, label) = (own, k as u16 + 1);
            }
        }
        (value, label)
    }

    /// Value of one plume alone.
    fn plume(&self, k: usize, x: f64, y: f64) -> f64 {
        let (plume, head) = (&PLUMES[k], &self.frame.heads[k]);
        let ([cx, cy], above, radius) = self.stems[k];
        let q = [x - head.centre[0], y - head.centre[1], self.z - head.centre[2]];
        let r = head.radius;
        let stem_squared = (x - cx).powi(2) + (y - cy).powi(2) + above * above;
        let flat_squared = q[0] * q[0] + q[1] * q[1];
        // nothing of the plume extends further than halo, turbulence and blend together
        let reach = HALO_REACH + 0.085;
        let far_from_cap = flat_squared > (1.1 * r + reach).powi(2) || q[2].abs() > r + reach;
        if stem_squared > (radius + reach).powi(2) && far_from_cap {
            return 0.0;
        }
        let (stem, flat) = (stem_squared.sqrt() - radius, flat_squared.sqrt());
        let dome = ellipsoid([q[0], q[1], q[2] - 0.12 * r], [0.86 * r, 0.86 * r, 0.62 * r]);
        let curl = (flat - 0.74 * r).hypot(q[2] + 0.26 * r) - 0.31 * r;
        let cap = smooth_min(dome, curl, 0.25 * r);
        let near_cap = step(1.0 - (q[2] + 0.3 * r).abs() / (2.0 * r));
        let rough = 0.016 + 0.036 * near_cap;
        let smooth = smooth_min(stem, cap, 0.07);
        let slack = rough * TURBULENCE_BOUND;
        if smooth - slack >= HALO_REACH {
            return 0.0;
        }
        if smooth + slack <= -HEART_DEPTH {
            return plume.peak;
        }
        let outside = smooth + rough * turbulence([x, y, self.z], self.frame.t, plume.phase);
        let halo = step(1.0 - outside / HALO_REACH);
        let flank = step((0.012 - outside) / 0.05);
        let heart = step(-(outside + 0.01) / (HEART_DEPTH - 0.01));
        HALO * halo + (plume.peak - HALO - HEART) * flank + HEART * heart
    }
}
