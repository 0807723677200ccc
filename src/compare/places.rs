//! Where variants are compared: each dataset on each device is a separate place.

use super::results::{ResultSet, VariantOutcome};

/// A dataset on a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct DatasetOnDevice {
    /// Name of the dataset; may be empty.
    pub dataset: String,
    /// Name of the device.
    pub device: String,
    /// What distinguishes it from the others: the dataset, with the device if there are several devices.
    pub name: String,
}

impl DatasetOnDevice {
    /// Whether `outcome` was measured here.
    pub fn holds(&self, outcome: &VariantOutcome) -> bool {
        outcome.dataset == self.dataset && outcome.device == self.device
    }
}

/// All places, in the order of the outcomes.
pub(super) fn places(set: &ResultSet) -> Vec<DatasetOnDevice> {
    let pairs = distinct(set.outcomes.iter().map(|o| (o.dataset.clone(), o.device.clone())));
    let several_devices = pairs.iter().any(|(_, device)| *device != pairs[0].1);
    let name = |dataset: &str, device: &str| match (several_devices, dataset.is_empty()) {
        (false, _) => dataset.to_owned(),
        (true, true) => device.to_owned(),
        (true, false) => format!("{dataset}, {device}"),
    };
    pairs
        .into_iter()
        .map(|(dataset, device)| DatasetOnDevice { name: name(&dataset, &device), dataset, device })
        .collect()
}

/// Returns the distinct values, in the order of their first occurrence.
pub(super) fn distinct<T: PartialEq>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut out = Vec::new();
    for value in values {
        if !out.contains(&value) {
            out.push(value);
        }
    }
    out
}
