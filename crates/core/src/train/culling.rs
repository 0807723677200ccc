//! Records which Gaussians were transparent at which training time, so that the next steps at that time may skip them.
//! A Gaussian that no pixel sees has no gradient; skipping it can only delay its return.

use crate::model::params::HostTensor;
use std::collections::BTreeMap;
use volseggs_kernels::activation::logit;
use volseggs_kernels::splat::ALPHA_MIN;

/// Bits that one number of a checkpoint holds exactly.
const BITS: usize = 16;
/// Prefix of its tensors in a checkpoint.
const PREFIX: &str = "culled.";

/// The culled Gaussians of each time seen so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Culling {
    /// Visits of a time from one that evaluates all Gaussians to the next; 0 if every visit does.
    every: usize,
    /// By the bits of the time: visits since the last that evaluated all, and which Gaussians are culled `[N]`.
    times: BTreeMap<u64, (usize, Vec<bool>)>,
}

impl Culling {
    /// Starts with none culled; one in `every` visits of a time evaluates all Gaussians, 0 for every visit.
    pub fn new(every: usize) -> Self {
        Self { every, times: BTreeMap::new() }
    }

    /// Returns which Gaussians `[N]` may be skipped in this visit of `time`; `None` if all are due.
    pub fn visit(&mut self, time: f64) -> Option<Vec<bool>> {
        let (visits, culled) = self.times.get_mut(&time.to_bits())?;
        *visits = visits.saturating_add(1);
        (*visits < self.every).then(|| culled.clone())
    }

    /// Whether any Gaussian is ever skipped.
    pub fn is_on(&self) -> bool {
        self.every > 1
    }

    /// Records which Gaussians are transparent at `time`, from their logits `[N]`, after a visit that evaluated all.
    pub fn record(&mut self, time: f64, opacity_logits: &[f32]) {
        if self.is_on() {
            let limit = logit(ALPHA_MIN);
            self.times.insert(time.to_bits(), (0, opacity_logits.iter().map(|&o| o < limit).collect()));
        }
    }

    /// Forgets everything, as when the set of Gaussians changes.
    pub fn clear(&mut self) {
        self.times.clear();
    }

    /// Returns the state as tensors for a checkpoint.
    pub fn to_tensors(&self) -> BTreeMap<String, HostTensor> {
        let pack = |bits: &[bool]| bits.iter().rev().fold(0u32, |v, b| v << 1 | u32::from(*b)) as f32;
        let tensor = |(time, (visits, culled)): (&u64, &(usize, Vec<bool>))| {
            let mut values = vec![*visits as f32];
            values.extend(culled.chunks(BITS).map(pack));
            (format!("{PREFIX}{time:016x}"), HostTensor { shape: vec![values.len()], values })
        };
        self.times.iter().map(tensor).collect()
    }

    /// Restores what [`Culling::to_tensors`] returned, for `n` Gaussians; entries that do not fit are skipped.
    pub fn load(&mut self, tensors: &BTreeMap<String, HostTensor>, n: usize) {
        self.times = tensors
            .iter()
            .filter_map(|(name, tensor)| {
                let time = u64::from_str_radix(name.strip_prefix(PREFIX)?, 16).ok()?;
                let (visits, packed) = tensor.values.split_first()?;
                let bits = packed.iter().flat_map(|&v| (0..BITS).map(move |k| v as u32 >> k & 1 == 1));
                let culled: Vec<bool> = bits.take(n).collect();
                (culled.len() == n).then_some((time, (*visits as usize, culled)))
            })
            .collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transparent_gaussians_are_skipped_until_all_are_due() {
        let mut culling = Culling::new(3);
        let logits: Vec<f32> = (0..40).map(|i| if i % 3 == 0 { -9.0 } else { 0.5 }).collect();
        assert_eq!(culling.visit(0.5), None);
        culling.record(0.5, &logits);
        let culled = culling.visit(0.5).unwrap();
        assert!(culled.iter().enumerate().all(|(i, a)| *a == (i % 3 == 0)));
        assert_eq!(culling.visit(0.25), None, "another time");

        assert!(culling.to_tensors().keys().all(|name| name == &format!("culled.{:016x}", 0.5f64.to_bits())));
        let mut again = Culling::new(3);
        again.load(&culling.to_tensors(), 40);
        assert_eq!(again, culling);
        assert!(again.visit(0.5).is_some() && again.visit(0.5).is_none(), "one of three visits evaluates all");
        again.load(&culling.to_tensors(), 41 + BITS);
        assert_eq!(again.visit(0.5), None, "of other Gaussians");
        culling.clear();
        assert_eq!(culling.visit(0.5), None);
    }

    #[test]
    fn by_default_none_is_culled() {
        let mut culling = Culling::new(0);
        culling.record(0.5, &[-9.0; 4]);
        assert_eq!(culling.visit(0.5), None);
        assert!(culling.to_tensors().is_empty());
    }
}
