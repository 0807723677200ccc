//! Gaussians on the host: the one type exchanged by training, segmentation, tracking, edits and files.
//!
//! The attributes of a Gaussian, their order and their widths are defined only by [`HostGaussians::columns`] and its
//! counterpart that reassembles columns; whatever copies, selects, checks, counts or moves rows goes through these.

use super::appearance::{HostShading, NORMALS};
use super::embedding::{EMBEDDING, HostEmbedding};
use super::params::to_vec;
use super::size;
use crate::config::types::ModelConfig;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::activation::sigmoid;
use volseggs_kernels::sh::Bands;
use volseggs_kernels::splat::SplatInputs;

/// Width of each attribute that every Gaussian has, with K = `sh_stride` coefficients.
fn widths(sh_stride: usize) -> [usize; 5] {
    [3, 4, 3, 1, 3 * sh_stride]
}

/// N Gaussians, canonical or at one time; flat and row-major.
///
/// ```
/// use volseggs_core::model::HostGaussians;
/// // one round white Gaussian at the origin
/// let one = HostGaussians {
///     means: vec![0.0; 3],
///     rotations: vec![1.0, 0.0, 0.0, 0.0],
///     log_scales: vec![-2.0; 3],
///     opacity_logits: vec![3.0],
///     sh: vec![1.77; 3],
///     sh_stride: 1,
///     ..HostGaussians::default()
/// };
/// assert_eq!(one.len(), 1);
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HostGaussians {
    /// Positions `[N, 3]`, scene units.
    pub means: Vec<f32>,
    /// Quaternions w, x, y, z `[N, 4]`, not necessarily of unit length.
    pub rotations: Vec<f32>,
    /// Natural logarithm of the standard deviations `[N, 3]`, scene units.
    pub log_scales: Vec<f32>,
    /// Opacity before the sigmoid `[N]`.
    pub opacity_logits: Vec<f32>,
    /// Spherical-harmonics coefficients `[N, K, 3]`.
    pub sh: Vec<f32>,
    /// K: 1, 4, 9 or 16, or 6 or 15 with even bands alone.
    pub sh_stride: usize,
    /// Shading, if any: the first coefficients are then base colours, see [`super::appearance`].
    pub shading: Option<HostShading>,
    /// Embeddings for the decoder, for canonical Gaussians alone, see [`super::embedding`].
    pub embedding: Option<HostEmbedding>,
}

/// One attribute of all Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttributeColumn<'a> {
    /// Its name: that of the field, and of the parameter within `gaussians.` in files.
    pub name: &'static str,
    /// Numbers per Gaussian.
    pub width: usize,
    /// `[N, width]`
    pub values: &'a [f32],
}

impl AttributeColumn<'_> {
    /// The numbers of one Gaussian `[width]`.
    ///
    /// # Panics
    /// If `i` is not below N.
    pub fn row(&self, i: usize) -> &[f32] {
        &self.values[i * self.width..][..self.width]
    }

    /// The numbers of the Gaussians `rows` `[M, width]`, in that order.
    ///
    /// # Panics
    /// If a row is not below N.
    pub fn gather(&self, rows: impl IntoIterator<Item = usize>) -> Vec<f32> {
        rows.into_iter().flat_map(|i| self.row(i)).copied().collect()
    }
}

impl HostGaussians {
    /// The attributes, in the order used by splatting; normals only with a shading, and the embedding last if there is
    /// one.
    pub fn columns(&self) -> impl Iterator<Item = AttributeColumn<'_>> {
        let normals = self.shading.iter().map(|s| AttributeColumn { name: NORMALS, width: 3, values: &s.normals });
        let embedding =
            self.embedding.iter().map(|e| AttributeColumn { name: EMBEDDING, width: e.width, values: &e.values });
        self.common_columns().into_iter().chain(normals).chain(embedding)
    }

    /// The attributes that every Gaussian has, in the same order.
    pub fn common_columns(&self) -> [AttributeColumn<'_>; 5] {
        let [means, rotations, log_scales, opacity_logits, sh] = widths(self.sh_stride);
        [
            AttributeColumn { name: "means", width: means, values: &self.means },
            AttributeColumn { name: "rotations", width: rotations, values: &self.rotations },
            AttributeColumn { name: "log_scales", width: log_scales, values: &self.log_scales },
            AttributeColumn { name: "opacity_logits", width: opacity_logits, values: &self.opacity_logits },
            AttributeColumn { name: "sh", width: sh, values: &self.sh },
        ]
    }

    /// N Gaussians with K coefficients, all numbers 0, without shading or embedding.
    pub fn zeros(n: usize, sh_stride: usize) -> Self {
        let [means, rotations, log_scales, opacity_logits, sh] = widths(sh_stride).map(|width| vec![0.0; n * width]);
        Self { means, rotations, log_scales, opacity_logits, sh, sh_stride, ..Self::default() }
    }

    /// One Gaussian with the attributes of a model's Gaussians: a placeholder for those of a file.
    pub fn one(model: &ModelConfig) -> Self {
        Self::zeros(1, size::coefficients(model) as usize).completed(model, 0)
    }

    /// The same with the initial values of the optional attributes that a model's Gaussians have and these lack.
    #[must_use]
    pub fn completed(mut self, model: &ModelConfig, seed: u64) -> Self {
        let n = self.len();
        self.shading = self.shading.or_else(|| HostShading::first(model, n, seed));
        self.embedding = self.embedding.or_else(|| HostEmbedding::first(model.embedding, n));
        self
    }

    /// New Gaussians with the same attributes, each column computed by `f` from the old one.
    pub fn map(&self, f: impl FnMut(AttributeColumn<'_>) -> Vec<f32>) -> Self {
        let mut columns = self.columns().map(f);
        // in the order of `columns`, which yields as many
        let mut next = || columns.next().unwrap_or_default();
        Self {
            means: next(),
            rotations: next(),
            log_scales: next(),
            opacity_logits: next(),
            sh: next(),
            sh_stride: self.sh_stride,
            shading: self.shading.as_ref().map(|shading| HostShading { normals: next(), ..shading.without_normals() }),
            embedding: self.embedding.as_ref().map(|e| HostEmbedding { width: e.width, values: next() }),
        }
    }

    /// N.
    pub fn len(&self) -> usize {
        self.opacity_logits.len()
    }

    /// True if there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.opacity_logits.is_empty()
    }

    /// Highest spherical-harmonics degree of K coefficients, 0 to 3, or 4 with even bands alone.
    pub fn sh_degree(&self) -> usize {
        Bands::from_count(self.sh_stride).map_or(0, |(_, degree)| degree)
    }

    /// The first attribute that does not hold N rows of its width, as `(column, expected number of values)`.
    pub fn mismatched_column(&self) -> Option<(AttributeColumn<'_>, usize)> {
        let n = self.len();
        self.columns().map(|c| (c, n * c.width)).find(|(c, wanted)| c.values.len() != *wanted)
    }

    /// Whether every number of Gaussian `i` is finite.
    ///
    /// # Panics
    /// If `i` is not below N.
    pub fn is_finite(&self, i: usize) -> bool {
        self.columns().all(|column| column.row(i).iter().all(|v| v.is_finite()))
    }

    /// Linear opacity `[N]`.
    pub fn opacity(&self) -> Vec<f32> {
        (0..self.len()).map(|i| self.opacity_of(i)).collect()
    }

    /// Linear opacity of one Gaussian.
    ///
    /// # Panics
    /// If `i` is not below N.
    pub fn opacity_of(&self, i: usize) -> f32 {
        sigmoid(self.opacity_logits[i])
    }

    /// Means `[M, 3]` of the visible Gaussians: opacity above 1 / 255.
    pub fn visible_means(&self) -> Vec<f32> {
        let rows = self.means.chunks_exact(3).zip(self.opacity()).filter(|(_, o)| *o > 1.0 / 255.0);
        rows.flat_map(|(m, _)| m).copied().collect()
    }

    /// The rows of `members` alone, in their order.
    ///
    /// # Panics
    /// If a member is not below N.
    pub fn subset(&self, members: &[u32]) -> Self {
        self.map(|column| column.gather(members.iter().map(|&i| i as usize)))
    }

    /// The same, wider by a blur with this standard deviation, scene units; their opacity stays, as in a picture whose
    /// dilation this is. What is not finite stays so.
    #[must_use]
    pub fn widened(mut self, by: f64) -> Self {
        for log in self.log_scales.iter_mut().filter(|log| log.is_finite()) {
            *log = f64::from(*log).exp().hypot(by).ln() as f32;
        }
        self
    }

    /// The same with unit quaternions, as other programs expect; a zero quaternion becomes the identity.
    #[must_use]
    pub fn with_unit_rotations(mut self) -> Self {
        for q in self.rotations.chunks_exact_mut(4) {
            let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt();
            if norm > 1e-12 {
                q.iter_mut().for_each(|v| *v /= norm);
            } else {
                q.copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
            }
        }
        self
    }

    /// Copies them to a device, as input for splatting.
    ///
    /// # Panics
    /// If the arrays disagree on N.
    pub fn to_splat(&self, device: &Device) -> SplatInputs {
        self.clone().into_splat(device)
    }

    /// The same Gaussians, all of the same grey.
    pub fn without_colours(&self) -> Self {
        Self {
            means: self.means.clone(),
            rotations: self.rotations.clone(),
            log_scales: self.log_scales.clone(),
            opacity_logits: self.opacity_logits.clone(),
            sh: vec![0.0; 3 * self.len()],
            sh_stride: 1,
            ..Self::default()
        }
    }

    /// [`HostGaussians::to_splat`] without a copy on the host.
    ///
    /// # Panics
    /// If the arrays disagree on N.
    pub fn into_splat(self, device: &Device) -> SplatInputs {
        let (n, k) = (self.len(), self.sh_stride);
        let [means, rotations, log_scales, ..] = widths(k);
        let rows = |values: Vec<f32>, width| Tensor::<2>::from_data(TensorData::new(values, [n, width]), device);
        SplatInputs {
            means: rows(self.means, means),
            rotations: rows(self.rotations, rotations),
            log_scales: rows(self.log_scales, log_scales),
            opacity_logits: Tensor::from_data(TensorData::new(self.opacity_logits, [n]), device),
            sh: Tensor::from_data(TensorData::new(self.sh, [n, k, 3]), device),
            screen_offsets: None,
            shading: self.shading.map(|shading| shading.into_device(device)),
        }
    }

    /// Copies Gaussians from a device; screen offsets are not an attribute and are dropped.
    pub fn from_splat(on_device: SplatInputs) -> Self {
        Self {
            sh_stride: on_device.sh.dims()[1],
            means: to_vec(on_device.means),
            rotations: to_vec(on_device.rotations),
            log_scales: to_vec(on_device.log_scales),
            opacity_logits: to_vec(on_device.opacity_logits),
            sh: to_vec(on_device.sh),
            shading: on_device.shading.map(HostShading::from_device),
            embedding: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Gaussians;
    use super::*;

    #[test]
    fn a_device_gives_back_what_it_got() {
        let device = crate::device::DeviceName::all()[0].open().unwrap();
        for all in [three(), shaded()] {
            assert_eq!(HostGaussians::from_splat(all.to_splat(&device)), all);
            assert_eq!(Gaussians::from_host(all.clone(), &device).to_host(), all);
        }
        assert_eq!(Gaussians::from_host(embedded(), &device).to_host(), embedded());
    }

    fn three() -> HostGaussians {
        let count = |n: usize, first: f32| (0..n).map(|i| first + i as f32).collect::<Vec<f32>>();
        HostGaussians {
            means: count(9, 0.0),
            rotations: count(12, 100.0),
            log_scales: count(9, 200.0),
            opacity_logits: count(3, 300.0),
            sh: count(36, 400.0),
            sh_stride: 4,
            ..HostGaussians::default()
        }
    }

    fn shaded() -> HostGaussians {
        let shading = HostShading { normals: (0..9).map(|i| 500.0 + i as f32).collect(), ..HostShading::default() };
        HostGaussians { shading: Some(shading), ..three() }
    }

    fn embedded() -> HostGaussians {
        let values = (0..6).map(|i| 600.0 + i as f32).collect();
        HostGaussians { embedding: Some(HostEmbedding { width: 2, values }), ..shaded() }
    }

    #[test]
    fn columns_are_all_there_is_and_go_back_together() {
        let all = three();
        assert_eq!((all.len(), all.sh_degree(), all.mismatched_column()), (3, 1, None));
        assert_eq!(all.map(|column| column.values.to_vec()), all);
        assert_eq!(all.map(|column| vec![0.0; column.values.len()]), HostGaussians::zeros(3, 4));
        let names = |g: &HostGaussians| g.columns().map(|c| c.name).collect::<Vec<_>>();
        assert_eq!(names(&all), ["means", "rotations", "log_scales", "opacity_logits", "sh"]);
        assert_eq!(all.columns().nth(1).unwrap().row(2), [108.0, 109.0, 110.0, 111.0]);
        let some = all.subset(&[2, 0]);
        assert_eq!((some.mismatched_column(), some.opacity_logits.as_slice()), (None, [302.0, 300.0].as_slice()));
        assert_eq!(some.subset(&[1]), all.subset(&[0]));
        let shaded = shaded();
        assert_eq!(shaded.map(|column| column.values.to_vec()), shaded);
        assert_eq!(names(&shaded).last(), Some(&NORMALS));
        assert_eq!(embedded().map(|column| column.values.to_vec()), embedded());
        assert_eq!(names(&embedded())[5..], [NORMALS, EMBEDDING]);
        assert_eq!(embedded().subset(&[2, 0]).embedding.unwrap().values, [604.0, 605.0, 600.0, 601.0]);
        assert_eq!(shaded.subset(&[2, 0]).shading.unwrap().normals, [506.0, 507.0, 508.0, 500.0, 501.0, 502.0]);
    }

    #[test]
    fn wrong_lengths_and_non_finite_values_are_named() {
        let mut all = three();
        all.log_scales[4] = f32::NAN;
        assert_eq!([0, 1, 2].map(|i| all.is_finite(i)), [true, false, true]);
        all.log_scales.pop();
        let (column, wanted) = all.mismatched_column().unwrap();
        assert_eq!((column.name, column.values.len(), wanted), ("log_scales", 8, 9));
    }

    #[test]
    fn rotations_get_length_one() {
        let mut all = three();
        all.rotations[..4].fill(0.0);
        let unit = all.with_unit_rotations().rotations;
        assert_eq!(unit[..4], [1.0, 0.0, 0.0, 0.0]);
        assert!(unit.chunks_exact(4).all(|q| (q.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-6));
    }
}
