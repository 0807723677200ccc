//! Which Gaussians were transparent at which training time, so that the next steps at that time may pass over them.
//! A Gaussian that no pixel can see has no gradient; all that is lost is the moment at which it would have come back.

use crate::model::params::HostTensor;
use std::collections::BTreeMap;
use volseggs_kernels::activation::logit;
use volseggs_kernels::splat::ALPHA_MIN;

/// Bits that a number of a checkpoint holds exactly.
const BITS: usize = 16;
/// Where a checkpoint keeps them; files of earlier versions hold this word.
const PREFIX: &str = "asleep.";

/// The Gaussians culled at each time seen so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Culling {
    /// Visits of a time from one look at all Gaussians to the next; 0 for always.
    every: usize,
    /// By the bits of the time: visits since the last look at all, and which are culled `[N]`.
    times: BTreeMap<u64, (usize, Vec<bool>)>,
}

impl Culling {
    /// None is culled yet; every Gaussian is looked at in one of `every` visits of a time, 0 for always.
    pub fn new(every: usize) -> Self {
        Self { every, times: BTreeMap::new() }
    }

    /// Which Gaussians `[N]` may be passed over in this visit of `time`; `None` if all are due.
    pub fn visit(&mut self, time: f64) -> Option<Vec<bool>> {
        let (visits, culled) = self.times.get_mut(&time.to_bits())?;
        *visits = visits.saturating_add(1);
        (*visits < self.every).then(|| culled.clone())
    }

    /// Whether any Gaussian is ever passed over.
    pub fn is_on(&self) -> bool {
        self.every > 1
    }

    /// Notes which are transparent at `time`, by their logits `[N]`, after a visit in which all were looked at.
    pub fn note(&mut self, time: f64, opacity_logits: &[f32]) {
        if self.is_on() {
            let limit = logit(ALPHA_MIN);
            self.times.insert(time.to_bits(), (0, opacity_logits.iter().map(|&o| o < limit).collect()));
        }
    }

    /// Forgets all, as when the Gaussians are others than before.
    pub fn clear(&mut self) {
        self.times.clear();
    }

    /// All of it as tensors for a checkpoint.
    pub fn to_tensors(&self) -> BTreeMap<String, HostTensor> {
        let pack = |bits: &[bool]| bits.iter().rev().fold(0u32, |v, b| v << 1 | u32::from(*b)) as f32;
        let tensor = |(time, (visits, culled)): (&u64, &(usize, Vec<bool>))| {
            let mut values = vec![*visits as f32];
            values.extend(culled.chunks(BITS).map(pack));
            (format!("{PREFIX}{time:016x}"), HostTensor { shape: vec![values.len()], values })
        };
        self.times.iter().map(tensor).collect()
    }

    /// Takes back what [`Culling::to_tensors`] gave, for `n` Gaussians; entries that do not fit are left out.
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
    fn the_transparent_are_passed_over_until_all_are_due() {
        let mut culling = Culling::new(3);
        let logits: Vec<f32> = (0..40).map(|i| if i % 3 == 0 { -9.0 } else { 0.5 }).collect();
        assert_eq!(culling.visit(0.5), None);
        culling.note(0.5, &logits);
        let culled = culling.visit(0.5).unwrap();
        assert!(culled.iter().enumerate().all(|(i, a)| *a == (i % 3 == 0)));
        assert_eq!(culling.visit(0.25), None, "another time");

        assert!(culling.to_tensors().keys().all(|name| name == &format!("asleep.{:016x}", 0.5f64.to_bits())));
        let mut again = Culling::new(3);
        again.load(&culling.to_tensors(), 40);
        assert_eq!(again, culling);
        assert!(again.visit(0.5).is_some() && again.visit(0.5).is_none(), "one of three visits looks at all");
        again.load(&culling.to_tensors(), 41 + BITS);
        assert_eq!(again.visit(0.5), None, "of other Gaussians");
        culling.clear();
        assert_eq!(culling.visit(0.5), None);
    }

    #[test]
    fn by_default_none_is_culled() {
        let mut culling = Culling::new(0);
        culling.note(0.5, &[-9.0; 4]);
        assert_eq!(culling.visit(0.5), None);
        assert!(culling.to_tensors().is_empty());
    }
}
