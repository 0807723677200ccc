//! `4dgs.*`

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use volseggs_core::config::sections::Settings;

/// Maximum number of orders of the colours' series in time.
const MAX_ORDERS: usize = 8;
/// Maximum number of neighbours of a Gaussian.
const MAX_NEIGHBOURS: usize = 256;

/// `4dgs.*`: Gaussians in space and time of native 4D Gaussian splatting; what they share with 3DGS is set in the other
/// sections. The defaults are the published settings, as used in the VolSegGS paper's comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FourDgsConfig {
    /// Orders in which colours change over time, in addition to the constant one; 0 for constant colours.
    pub time_orders: usize,
    /// Margin by which the initial peak times extend beyond the first and the last time.
    pub time_margin: f64,
    /// Initial standard deviation of the Gaussians along time; the whole time range is 1.
    pub time_scale: f64,
    /// Learning rate of the peak times, as a multiple of the scene's extent; it is constant.
    pub times: f64,
    /// Mean absolute gradient with respect to the peak time above which Gaussians are added as well; 0 disables this.
    pub time_threshold: f64,
    /// Weight of the differences between the velocities of neighbours; 0 for none.
    pub rigid: f64,
    /// Number of neighbours of each Gaussian, itself included.
    pub rigid_neighbours: usize,
    /// Steps between searches for neighbours.
    pub rigid_every: usize,
}

impl Settings for FourDgsConfig {
    const SECTION: &'static str = "4dgs";
}

impl Default for FourDgsConfig {
    fn default() -> Self {
        Self {
            time_orders: 2,
            time_margin: 0.1,
            time_scale: 0.447_213_6,
            times: 1.6e-4,
            time_threshold: 0.0,
            rigid: 1.0,
            rigid_neighbours: 20,
            rigid_every: 100,
        }
    }
}

impl FourDgsConfig {
    /// Rejects settings that no training can start with.
    ///
    /// # Errors
    /// The first invalid key with its value, and the values allowed.
    pub fn check(&self) -> Result<(), String> {
        if self.time_orders > MAX_ORDERS {
            return Err(format!("4dgs.time_orders = {}: at most {MAX_ORDERS}", self.time_orders));
        }
        for (key, value, min, max) in
            [("time_margin", self.time_margin, 0.0, 10.0), ("time_scale", self.time_scale, 1e-6, 1e6)]
        {
            if !(min..=max).contains(&value) {
                return Err(format!("4dgs.{key} = {value:?}: between {min:?} and {max:?}"));
            }
        }
        if self.rigid > 0.0 && !(2..=MAX_NEIGHBOURS).contains(&self.rigid_neighbours) {
            let n = self.rigid_neighbours;
            return Err(format!("4dgs.rigid_neighbours = {n}: between 2 and {MAX_NEIGHBOURS}, itself included"));
        }
        if self.rigid > 0.0 && self.rigid_every == 0 {
            return Err("4dgs.rigid_every = 0: at least 1; 4dgs.rigid=0 turns it off".into());
        }
        Ok(())
    }

    /// Number of values per Gaussian, with spherical harmonics of degree `sh_degree` at each order in time.
    pub fn numbers(&self, sh_degree: usize) -> u128 {
        // position, time; scales; two quaternions; opacity
        self.colours(sh_degree).saturating_add(3 + 1 + 4 + 4 + 4 + 1)
    }

    /// Number of values of its colours.
    pub fn colours(&self, sh_degree: usize) -> u128 {
        let coefficients = (sh_degree as u128).saturating_add(1).saturating_pow(2);
        (self.time_orders as u128).saturating_add(1).saturating_mul(coefficients).saturating_mul(3)
    }

    /// Values that a step keeps for each Gaussian until the gradients are computed, besides its own: rotations and
    /// their factors, quantities conditioned on a time, terms of the colours, velocities of neighbours. As measured,
    /// 100,000 published Gaussians take 0.7 GB.
    pub fn kept_values(&self, sh_degree: usize) -> u128 {
        let neighbours = if self.rigid > 0.0 { self.rigid_neighbours } else { 0 };
        self.colours(sh_degree).saturating_mul(2).saturating_add(400).saturating_add(14 * neighbours as u128)
    }
}

#[cfg(test)]
mod tests {
    use super::FourDgsConfig;

    #[test]
    fn a_published_gaussian_has_161_values() {
        assert_eq!(FourDgsConfig::default().numbers(3), 161);
        assert_eq!(FourDgsConfig { time_orders: 2, ..FourDgsConfig::default() }.numbers(1), 53);
    }

    #[test]
    fn invalid_values_are_named() {
        FourDgsConfig::default().check().unwrap();
        type Edit = fn(&mut FourDgsConfig);
        let cases: [(Edit, &str); 6] = [
            (|c| c.time_orders = 9, "4dgs.time_orders = 9: at most 8"),
            (|c| c.time_scale = 0.0, "4dgs.time_scale = 0.0: between"),
            (|c| c.time_scale = f64::NAN, "4dgs.time_scale = NaN: between"),
            (|c| c.time_margin = 11.0, "4dgs.time_margin = 11.0: between"),
            (|c| c.rigid_neighbours = 1, "4dgs.rigid_neighbours = 1: between 2 and 256"),
            (|c| c.rigid_every = 0, "4dgs.rigid_every = 0: at least 1"),
        ];
        for (edit, words) in cases {
            let mut config = FourDgsConfig::default();
            edit(&mut config);
            let text = config.check().unwrap_err();
            assert!(text.contains(words), "{text}");
        }
    }
}
