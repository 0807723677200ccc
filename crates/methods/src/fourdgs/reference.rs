//! 4D Gaussians at a time in plain f64: the reference for the tests. Rotations are products of quaternions; covariances
//! are sums over axes, conditioned by the textbook formula.

/// One Gaussian, with the parameters of [`super::Gaussians4d`].
#[derive(Clone, Debug)]
pub(super) struct Gaussian {
    pub mean: [f64; 3],
    pub time: f64,
    pub log_scales: [f64; 4],
    pub left: [f64; 4],
    pub right: [f64; 4],
    pub opacity_logit: f64,
    /// `[O K, 3]`
    pub sh: Vec<f64>,
}

/// The Gaussian as drawn at a time.
#[derive(Clone, Debug)]
pub(super) struct GaussianAtTime {
    pub mean: [f64; 3],
    /// xx, xy, xz, yy, yz, zz
    pub covariance: [f64; 6],
    pub velocity: [f64; 3],
    pub marginal: f64,
    pub opacity_logit: f64,
    /// `[K, 3]`
    pub sh: Vec<f64>,
}

/// Hamilton's product of quaternions (w, i, j, k).
fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

fn unit(q: [f64; 4]) -> [f64; 4] {
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / length)
}

/// `l v conj(r)` with `v = t + z i + y j + x k`, for a vector (x, y, z, t).
pub(super) fn rotated([x, y, z, t]: [f64; 4], left: [f64; 4], right: [f64; 4]) -> [f64; 4] {
    let [w, i, j, k] = unit(right);
    let [t, z, y, x] = product(product(unit(left), [t, z, y, x]), [w, -i, -j, -k]);
    [x, y, z, t]
}

impl Gaussian {
    /// The Gaussian at `time`, with K coefficients for each order in time up to `time_degree`.
    pub(super) fn at(&self, time: f64, stride: usize, time_degree: usize, duration: f64) -> GaussianAtTime {
        let axes: [[f64; 4]; 4] = std::array::from_fn(|k| {
            let axis = std::array::from_fn(|r| if r == k { self.log_scales[k].exp() } else { 0.0 });
            rotated(axis, self.left, self.right)
        });
        let sigma = |a: usize, b: usize| -> f64 { axes.iter().map(|axis| axis[a] * axis[b]).sum() };
        let (since, variance) = (time - self.time, sigma(3, 3));
        let velocity: [f64; 3] = std::array::from_fn(|k| sigma(k, 3) / variance);
        let marginal = (-since * since / (2.0 * variance)).exp();
        let opacity = marginal / (1.0 + (-self.opacity_logit).exp());
        let places = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        let mut sh = vec![0.0; 3 * stride];
        for order in 0..=time_degree {
            let angle = std::f64::consts::TAU * order as f64 * (self.time - time) / duration;
            let of = &self.sh[3 * stride * order..][..3 * stride];
            sh.iter_mut().zip(of).for_each(|(sum, c)| *sum += angle.cos() * c);
        }
        GaussianAtTime {
            mean: std::array::from_fn(|k| self.mean[k] + velocity[k] * since),
            covariance: places.map(|(a, b)| sigma(a, b) - sigma(a, 3) * sigma(b, 3) / variance),
            velocity,
            marginal,
            opacity_logit: (opacity / (1.0 - opacity)).ln(),
            sh,
        }
    }
}
