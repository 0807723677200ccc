//! What the masks say at a few pixels of each view, kept with the field: a click is held against it, see [`super::levels`].

use super::views::FineView;
use crate::model::params::HostTensor;
use crate::rng::{Purpose, Rng};
use std::collections::BTreeMap;
use volseggs_kernels::contributors::Contributors;

/// Pixels kept of a view, at most: 30 views are 2 to 4 MB, and a threshold is held against all of them in a millisecond.
const PIXELS: usize = 1024;

/// Pixels of the views that the field was trained on, what they are made of, and the masks that cover them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Number of the view of each pixel, ascending, `[P]`.
    pub views: Vec<u32>,
    /// What each pixel is made of: indices into the scene's Gaussians.
    pub pixels: Contributors,
    /// Where each pixel's list of masks starts, `[P + 1]`.
    pub offsets: Vec<u32>,
    /// Numbers of the masks that cover a pixel, within its view, from small to large.
    pub masks: Vec<u32>,
    /// Their scales: the place of each among all masks, in [0, 1].
    pub scales: Vec<f32>,
}

/// Why stored evidence cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{tensor}: {problem}; train the field again with `volseggs segment fine`")]
pub struct EvidenceError {
    /// The tensor.
    pub tensor: &'static str,
    /// What is wrong.
    pub problem: String,
}

/// Names of the tensors, in the order of the fields.
const NAMES: [&str; 7] = [
    "evidence.views",
    "evidence.pixel_offsets",
    "evidence.pixel_gaussians",
    "evidence.pixel_weights",
    "evidence.mask_offsets",
    "evidence.masks",
    "evidence.scales",
];

impl Evidence {
    /// Pixels of each view, drawn at random; `scales` of the views are ranks.
    #[must_use]
    pub fn of(views: &[FineView], seed: u64) -> Self {
        let mut out = Self { offsets: vec![0], ..Self::default() };
        out.pixels.offsets.push(0);
        for (number, view) in (0..).zip(views) {
            let mut chosen: Vec<usize> = (0..view.pixels.len()).collect();
            Rng::new(seed, u64::from(number), Purpose::AffinitySteps as u64 + 2000).shuffle(&mut chosen);
            chosen.truncate(PIXELS);
            chosen.sort_unstable();
            for p in chosen {
                let (indices, weights) = view.pixels.row(p);
                out.views.push(number);
                out.pixels.indices.extend(indices.iter().map(|&i| view.globals[i as usize]));
                out.pixels.weights.extend_from_slice(weights);
                out.pixels.offsets.push(out.pixels.indices.len() as u32);
                out.masks.extend_from_slice(view.covering(p));
                out.scales.extend(view.covering(p).iter().map(|&m| view.scales[m as usize]));
                out.offsets.push(out.masks.len() as u32);
            }
        }
        out
    }

    /// Number of pixels, P.
    #[must_use]
    pub fn len(&self) -> usize {
        self.views.len()
    }

    /// True without any pixel: a field of an older program.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// Masks that cover pixel `p` and their scales, from small to large.
    ///
    /// # Panics
    /// If `p` is not below [`Self::len`].
    #[must_use]
    pub fn covering(&self, p: usize) -> (&[u32], &[f32]) {
        let range = self.offsets[p] as usize..self.offsets[p + 1] as usize;
        (&self.masks[range.clone()], &self.scales[range])
    }

    /// As tensors by name; whole numbers are exact in single precision.
    #[must_use]
    pub fn to_tensors(&self) -> BTreeMap<String, HostTensor> {
        let whole = |v: &[u32]| v.iter().map(|&v| v as f32).collect::<Vec<f32>>();
        let values = [
            whole(&self.views),
            whole(&self.pixels.offsets),
            whole(&self.pixels.indices),
            self.pixels.weights.clone(),
            whole(&self.offsets),
            whole(&self.masks),
            self.scales.clone(),
        ];
        let tensor = |values: Vec<f32>| HostTensor { shape: vec![values.len()], values };
        NAMES.iter().zip(values).map(|(name, values)| ((*name).to_owned(), tensor(values))).collect()
    }

    /// Takes what [`Self::to_tensors`] gave out of `tensors`; empty if none of them is there.
    ///
    /// # Errors
    /// If some are missing, disagree, or name other than the scene's `gaussians`.
    pub fn take(tensors: &mut BTreeMap<String, HostTensor>, gaussians: usize) -> Result<Self, EvidenceError> {
        let found = NAMES.map(|name| tensors.remove(name).map(|t| t.values));
        if found.iter().all(Option::is_none) {
            return Ok(Self::default());
        }
        let fail = |tensor: &'static str, problem: &str| EvidenceError { tensor, problem: problem.to_owned() };
        let mut values = Vec::new();
        for (name, found) in NAMES.into_iter().zip(found) {
            values.push(found.ok_or_else(|| fail(name, "is missing"))?);
        }
        let whole = |k: usize| -> Result<Vec<u32>, EvidenceError> {
            let exact = |v: &f32| (0.0..=16_777_216.0).contains(v) && v.fract() == 0.0;
            if !values[k].iter().all(exact) {
                return Err(fail(NAMES[k], "holds what is no whole number from 0 to 2^24"));
            }
            Ok(values[k].iter().map(|&v| v as u32).collect())
        };
        let out = Self {
            views: whole(0)?,
            pixels: Contributors { offsets: whole(1)?, indices: whole(2)?, weights: values[3].clone() },
            offsets: whole(4)?,
            masks: whole(5)?,
            scales: values[6].clone(),
        };
        let lists = |offsets: &[u32], entries: usize| {
            offsets.len() == out.len() + 1
                && offsets[0] == 0
                && offsets.is_sorted()
                && offsets.last() == Some(&(entries as u32))
        };
        if !lists(&out.pixels.offsets, out.pixels.indices.len()) || out.pixels.weights.len() != out.pixels.indices.len()
        {
            return Err(fail(NAMES[1], "does not fit the pixels and what they are made of"));
        }
        if !lists(&out.offsets, out.masks.len()) || out.scales.len() != out.masks.len() {
            return Err(fail(NAMES[4], "does not fit the pixels and their masks"));
        }
        if out.pixels.indices.iter().any(|&i| i as usize >= gaussians) {
            return Err(fail(NAMES[2], &format!("names a Gaussian that is not among the scene's {gaussians}")));
        }
        if !out.views.is_sorted() {
            return Err(fail(NAMES[0], "is not ascending"));
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::balls::APART;

    #[test]
    fn what_is_stored_comes_back_and_damage_is_told() {
        let at = APART.gaussians();
        let evidence = Evidence::of(&APART.prepared(&at), 0);
        assert!(evidence.len() > 100 && evidence.masks.len() >= evidence.len(), "{}", evidence.len());
        let tensors = evidence.to_tensors();
        assert_eq!(Evidence::take(&mut tensors.clone(), at.len()).unwrap(), evidence);
        assert!(Evidence::take(&mut BTreeMap::new(), 0).unwrap().is_empty());
        assert!(Evidence::take(&mut tensors.clone(), 3).is_err(), "of a smaller scene");
        for name in NAMES {
            let mut missing = tensors.clone();
            missing.remove(name);
            assert_eq!(Evidence::take(&mut missing, at.len()).unwrap_err().tensor, name);
            let mut short = tensors.clone();
            short.get_mut(name).unwrap().values.pop();
            assert!(Evidence::take(&mut short, at.len()).is_err(), "{name}");
        }
        for poison in [f32::NAN, -1.0, 0.5, 1e30] {
            let mut bad = tensors.clone();
            bad.get_mut(NAMES[2]).unwrap().values[0] = poison;
            assert_eq!(Evidence::take(&mut bad, at.len()).unwrap_err().tensor, NAMES[2]);
        }
    }
}
