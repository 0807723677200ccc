//! The dataset as a configuration wants it: size, splits, which of the training views.

use crate::config::types::Config;
use crate::data::thin::thinned;
use crate::data::{DataError, Dataset, OpenOptions, SplitName};
use std::path::Path;

/// Opens `root` for training with `config`; test views come along where they are looked at while training.
///
/// # Errors
/// As [`Dataset::open`].
pub fn open_dataset(root: &Path, config: &Config) -> Result<Dataset, DataError> {
    let mut splits = vec![SplitName::Train];
    if config.output.eval_every > 0 && Dataset::present(root).contains(&SplitName::Test) {
        splits.push(SplitName::Test);
    }
    let options = OpenOptions { downscale: config.data.downscale, splits: &splits, max_views: None };
    let mut dataset = Dataset::open(root, &options)?;
    dataset.train = thinned(dataset.train, config.data.times, config.data.views_per_time);
    Ok(dataset)
}
