//! A material: where its colours lie, and how it looks under full light.

use super::Smooth;

/// Gaussians of one material.
#[derive(Debug, Clone)]
pub(super) struct Members {
    /// Their rows.
    pub rows: Vec<u32>,
    /// Weight of lightness for it, 0 where lightness separates nothing.
    pub light: f32,
}

/// The position of a material in the space of colours.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Centre {
    /// Median colour in the plane `[2]`.
    pub plane: [f32; 2],
    /// Median logarithm of the brightness under full light.
    pub light: f32,
    /// Weight of a difference in lightness.
    pub lightness: f32,
    /// Its colour where it is shown clearly, in the plane `[2]`.
    pub shown: [f32; 2],
    /// Its brightest channel under full light.
    pub brightest: f32,
}

impl Centre {
    /// The weighted centre of `members`, whose colour is shown clearly at the quantile `lit` of brightness and chroma.
    pub fn weighted(members: &Members, smooth: &Smooth, weights: &[f32], lit: f64) -> Self {
        let quantile = |share: f64, value: &dyn Fn(usize) -> f32| {
            let rows = members.rows.iter().map(|&i| i as usize);
            weighted_quantile(rows.map(|i| (value(i), weights[i])).collect(), share)
        };
        let plane = [0, 1].map(|a| quantile(0.5, &|i| smooth.plane[i][a]));
        let length = plane[0].hypot(plane[1]);
        let hue = if length > 0.0 { plane.map(|v| v / length) } else { [0.0; 2] };
        let clear = quantile(lit, &|i| smooth.plane[i][0] * hue[0] + smooth.plane[i][1] * hue[1]);
        Self {
            plane,
            light: quantile(0.5, &|i| smooth.light[i]),
            lightness: members.light,
            shown: hue.map(|v| v * clear),
            brightest: quantile(lit, &|i| smooth.light[i]).exp(),
        }
    }

    /// Squared distance to a colour in the plane, including lightness where that counts.
    pub fn squared(&self, plane: [f32; 2], light: f32) -> f32 {
        self.squared_in_plane(plane) + (self.lightness * (light - self.light)).powi(2)
    }

    /// Squared distance to a colour in the plane alone.
    pub fn squared_in_plane(&self, plane: [f32; 2]) -> f32 {
        [0, 1].map(|a| (plane[a] - self.plane[a]).powi(2)).iter().sum()
    }
}

/// The value below which `share` of the weight lies; all values count equally if none has weight, and no values give 0.
fn weighted_quantile(mut values: Vec<(f32, f32)>, share: f64) -> f32 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let total: f64 = values.iter().map(|v| f64::from(v.1)).sum();
    if total <= 0.0 {
        let middle = (values.len() as f64 * share) as usize;
        return values.get(middle).map_or(0.0, |v| v.0);
    }
    let mut left = share * total;
    for &(value, weight) in &values {
        left -= f64::from(weight);
        if left <= 0.0 {
            return value;
        }
    }
    values.last().map_or(0.0, |v| v.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_follow_the_weights() {
        let values = vec![(3.0, 1.0), (1.0, 1.0), (2.0, 1.0), (100.0, 0.1)];
        assert_eq!(weighted_quantile(values.clone(), 0.5), 2.0);
        assert_eq!(weighted_quantile(values, 1.0), 100.0);
        assert_eq!(weighted_quantile(vec![(1.0, 0.0), (2.0, 0.0), (3.0, 0.0)], 0.5), 2.0);
        assert_eq!(weighted_quantile(Vec::new(), 0.5), 0.0);
    }
}
