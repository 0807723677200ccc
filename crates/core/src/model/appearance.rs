//! Appearance as shading: a base colour, a normal that moves with the Gaussian, and one shared material under a
//! headlight, in place of a colour expanded in spherical harmonics over all directions.
//!
//! The training images are shaded by Blinn-Phong with a white light at the eye (`volume::raycast`). Spherical harmonics
//! of degree 3 cannot represent the narrow dark rims that this gives thin shells, need 48 coefficients to learn from
//! few views what two directions encode, and stay in world axes while objects rotate. Here the first coefficients are
//! the unlit base colour; a normal in the Gaussian's own frame is rotated by its rotation at the time; the material is
//! shared by all Gaussians; and coefficients beyond the first, up to `model.sh_degree`, add the residual. The formula
//! is in [`volseggs_kernels::shading`].
//!
//! A run has its appearance from the first step. A conversion after warm-up would find little to convert: warm-up lasts
//! a few hundred steps, its harmonics come from few views, and an initial normal is soon corrected, since two-sided
//! diffuse light leads to the right one from almost everywhere. The parameters therefore stay the same throughout a
//! run, for the optimiser, checkpoints and resumed runs.

use super::host::HostGaussians;
use super::params::to_vec;
use super::sh::{C0, basis};
use crate::config::types::{Appearance, ModelConfig};
use crate::rng::{Purpose, Rng};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use glam::{Quat, Vec3};
use volseggs_kernels::sh::Bands;
use volseggs_kernels::shading::{GaussianShading, Light, MATERIAL, Material};

/// Name of the normals among a Gaussian's attributes, see [`HostGaussians::columns`].
pub const NORMALS: &str = "headlight.normals";
/// Name of the parameter shared by all Gaussians, `[3]`.
pub const MATERIAL_NAME: &str = "gaussians.headlight.material";

/// Initial material: the default of the transfer functions.
const INITIAL_MATERIAL: Material = Material { ambient: 0.3, specular: 0.2, exponent: 20.0 };

/// The shading parameters trained beside the Gaussians' other attributes.
#[derive(Module, Debug)]
pub struct Headlight {
    /// Normals in the Gaussians' own frames `[N, 3]`, of any length.
    pub normals: Param<Tensor<2>>,
    /// The material, as [`Material::to_trained`] `[3]`.
    pub material: Param<Tensor<1>>,
}

impl Headlight {
    /// Moves it to a device.
    pub fn from_host(host: HostShading, device: &Device) -> Self {
        let GaussianShading { normals, material, .. } = host.into_device(device);
        Self { normals: Param::from_tensor(normals), material: Param::from_tensor(material) }
    }

    /// The input for splatting, with gradients where the parameters have them.
    pub fn val(&self) -> GaussianShading {
        GaussianShading { normals: self.normals.val(), material: self.material.val(), light: Light::Head }
    }
}

/// The shading of N Gaussians on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct HostShading {
    /// Normals in the Gaussians' own frames `[N, 3]`, of any length.
    pub normals: Vec<f32>,
    /// The material, as [`Material::to_trained`].
    pub material: [f32; MATERIAL],
    /// Where the light is.
    pub light: Light,
}

/// No Gaussians, with the initial material.
impl Default for HostShading {
    fn default() -> Self {
        Self { normals: Vec::new(), material: INITIAL_MATERIAL.to_trained(), light: Light::Head }
    }
}

impl HostShading {
    /// The initial shading, with random normals, if `config` asks for one.
    pub fn first(config: &ModelConfig, n: usize, seed: u64) -> Option<Self> {
        match config.appearance {
            Appearance::Sh => None,
            Appearance::Headlight => {
                let mut rng = Rng::new(seed, 0, Purpose::Normals);
                let normal = |rng: &mut Rng| {
                    let v = Vec3::from_array(std::array::from_fn(|_| rng.normal()));
                    v.try_normalize().unwrap_or(Vec3::Z).to_array()
                };
                Some(Self { normals: (0..n).flat_map(|_| normal(&mut rng)).collect(), ..Self::default() })
            }
        }
    }

    /// The same shading without Gaussians.
    pub(super) fn without_normals(&self) -> Self {
        Self { normals: Vec::new(), ..*self }
    }

    pub(super) fn into_device(self, device: &Device) -> GaussianShading {
        let n = self.normals.len() / 3;
        GaussianShading {
            normals: Tensor::from_data(TensorData::new(self.normals, [n, 3]), device),
            material: Tensor::from_data(TensorData::new(self.material.to_vec(), [MATERIAL]), device),
            light: self.light,
        }
    }

    pub(super) fn from_device(on_device: GaussianShading) -> Self {
        let values = to_vec(on_device.material);
        Self {
            normals: to_vec(on_device.normals),
            material: std::array::from_fn(|i| values[i]),
            light: on_device.light,
        }
    }
}

impl HostGaussians {
    /// The same Gaussians without shading, in spherical harmonics of all bands up to degree 3: for files and programs that
    /// know these alone. They approximate the appearance under a headlight as closely as degree 2, or their own degree if
    /// higher, allows; of even bands, which are orthogonal to each other, those up to degree 2 stay and band 4 is lost.
    ///
    /// The headlight term of a normal `n` depends on `|n.d|` alone, where `d` is the view direction, so by the
    /// Funk-Hecke theorem its coefficient of band `l` is `Y_l(n)` times `2 pi` times the integral of `g(t) P_l(t)` over
    /// [-1, 1]. For `|t|^p` that factor is `4 pi` times 1 / (p + 1) in band 0 and p / ((p + 1) (p + 3)) in band 2; odd
    /// bands vanish.
    pub fn baked(&self) -> Self {
        if Bands::of_any(self.sh_stride) == Bands::Even {
            let mut sh = vec![0.0; 27 * self.len()];
            for (new, old) in sh.chunks_exact_mut(27).zip(self.sh.chunks_exact(3 * self.sh_stride)) {
                new[..3].copy_from_slice(&old[..3]);
                new[12..].copy_from_slice(&old[3..18]);
            }
            return Self { sh, sh_stride: 9, ..self.clone() }.baked();
        }
        let Some(shading) = &self.shading else { return self.clone() };
        let Material { ambient, specular, exponent } = Material::from_trained(shading.material);
        let sphere = 4.0 * std::f32::consts::PI;
        let bands = |p: f32| [sphere / (p + 1.0), sphere * p / ((p + 1.0) * (p + 3.0))];
        let (diffuse, shine) = (bands(1.0), bands(exponent));
        let k = self.sh_stride.max(9);
        let mut sh = vec![0.0; 3 * k * self.len()];
        for (i, (new, old)) in sh.chunks_exact_mut(3 * k).zip(self.sh.chunks_exact(3 * self.sh_stride)).enumerate() {
            new[..old.len()].copy_from_slice(old);
            let [w, x, y, z] = std::array::from_fn(|c| self.rotations[4 * i + c]);
            let turn = Quat::from_xyzw(x, y, z, w);
            let turn = if turn.length_squared() > 1e-12 { turn.normalize() } else { Quat::IDENTITY };
            let normal = turn * Vec3::from_slice(&shading.normals[3 * i..3 * i + 3]);
            let Some(normal) = normal.try_normalize() else { continue };
            let y = basis(normal.to_array());
            for c in 0..3 {
                let base = 0.5 + C0 * old[c];
                let of_band = |band: usize| base * (1.0 - ambient) * diffuse[band] + specular * shine[band];
                // the constant function 1 has the coefficient 1 / C0; drawing adds 0.5
                new[c] = (base * ambient - 0.5) / C0 + of_band(0) * y[0];
                (4..9).for_each(|j| new[3 * j + c] += of_band(1) * y[j]);
            }
        }
        Self { sh, sh_stride: k, shading: None, ..self.clone() }
    }

    /// The colours used for segmentation: the coefficients `[N, K, 3]` and K. For shaded Gaussians these are the unlit
    /// base colours alone, `[N, 1, 3]`.
    pub fn material_colours(&self) -> (std::borrow::Cow<'_, [f32]>, usize) {
        if self.shading.is_none() || self.sh_stride == 1 {
            return (self.sh.as_slice().into(), self.sh_stride);
        }
        let base: Vec<f32> = self.sh.chunks_exact(3 * self.sh_stride).flat_map(|c| &c[..3]).copied().collect();
        (base.into(), 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sh::basis_of;
    use volseggs_kernels::shading::reference::{LitGaussian, colour};

    #[test]
    fn baked_even_bands_lose_only_the_fourth() {
        for k in [6, 15] {
            let sh: Vec<f32> = (0..3 * k).map(|i| 0.1 * (i as f32 + 1.0).sin()).collect();
            let mut upto_2 = sh.clone();
            upto_2[18..].fill(0.0);
            let baked = HostGaussians { sh, ..HostGaussians::zeros(1, k) }.baked();
            assert_eq!((baked.sh_stride, baked.sh_degree(), baked.mismatched_column()), (9, 2, None));
            for d in crate::points::sampling::fibonacci_sphere(50) {
                let value = |sh: &[f32], y: [f32; 16]| sh.chunks_exact(3).zip(y).map(|(c, y)| c[1] * y).sum::<f32>();
                let (new, old) = (value(&baked.sh, basis(d)), value(&upto_2, basis_of(k, d)));
                assert!((new - old).abs() < 1e-6, "{k}: {new} {old}");
            }
        }
    }

    #[test]
    fn baked_harmonics_are_the_projection_of_what_is_shaded() {
        let material = Material { ambient: 0.25, specular: 0.3, exponent: 5.0 };
        let shading =
            HostShading { normals: vec![0.3, -1.2, 0.8], material: material.to_trained(), light: Light::Head };
        let gaussian = HostGaussians {
            means: vec![0.0; 3],
            rotations: vec![0.9, -0.4, 0.6, 1.1],
            log_scales: vec![0.0; 3],
            opacity_logits: vec![0.0],
            sh: vec![0.4, -0.2, 0.1, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09],
            sh_stride: 4,
            shading: Some(shading.clone()),
            ..HostGaussians::default()
        };
        let baked = gaussian.baked();
        assert_eq!((baked.sh_stride, &baked.shading, baked.mismatched_column()), (9, &None, None));
        assert_eq!(baked.sh[3..12], gaussian.sh[3..12], "the rest is unchanged");
        // numerically: integrals over the sphere of the shaded colour times each function of bands 0 and 2
        let directions = crate::points::sampling::fibonacci_sphere(20_000);
        let mut sums = [[0.0f64; 3]; 9];
        for d in &directions {
            let lit = LitGaussian {
                mean: [0.0; 3],
                rotation: std::array::from_fn(|c| f64::from(gaussian.rotations[c])),
                sh: std::array::from_fn(|c| f64::from(gaussian.sh[c])),
                normal: std::array::from_fn(|c| f64::from(shading.normals[c])),
                material: shading.material.map(f64::from),
                // drawing takes the direction from the eye, and both sides look the same
                eye: d.map(f64::from),
                light: Light::Head,
            };
            let (seen, y) = (colour(&lit), basis(*d));
            for (sum, y) in sums.iter_mut().zip(y) {
                (0..3).for_each(|c| sum[c] += (seen[c] - 0.5) * f64::from(y));
            }
        }
        let weight = 4.0 * std::f64::consts::PI / directions.len() as f64;
        for j in (0..1).chain(4..9) {
            for c in 0..3 {
                let (found, want) = (f64::from(baked.sh[3 * j + c]), weight * sums[j][c]);
                assert!((found - want).abs() < 2e-3, "{j} {c}: {found} {want}");
            }
        }
    }

    #[test]
    fn segments_see_base_colours() {
        let mut all = HostGaussians { sh: (0..24).map(|i| i as f32).collect(), ..HostGaussians::zeros(2, 4) };
        assert_eq!(all.material_colours(), (all.sh.as_slice().into(), 4));
        all.shading = Some(HostShading { normals: vec![1.0; 6], ..HostShading::default() });
        assert_eq!(all.material_colours(), (vec![0.0, 1.0, 2.0, 12.0, 13.0, 14.0].into(), 1));
    }
}
