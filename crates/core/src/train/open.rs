//! Opens a dataset as a configuration requests it: image size, splits and selection of views.

use crate::config::types::{Config, DataConfig};
use crate::data::dataset::{read_split, renumber};
use crate::data::images::ImageSet;
use crate::data::thin::{at_times, evenly, nearest_times, thinned};
use crate::data::{DataError, Dataset, Normalisation, OpenOptions, Split, SplitName};
use crate::rng::{Purpose, Rng};
use std::path::Path;

/// Opens `root` for training with `config`, including the test views if they are evaluated during training.
///
/// # Errors
/// As [`Dataset::open`], if two of `data.only_times` select the same time, or if there are fewer times or views than the
/// configuration asks for.
pub fn open_dataset(root: &Path, config: &Config) -> Result<Dataset, DataError> {
    let mut splits = vec![SplitName::Train];
    if config.output.eval_every > 0 && Dataset::present(root).contains(&SplitName::Test) {
        splits.push(SplitName::Test);
    }
    let options = OpenOptions { downscale: config.data.downscale, splits: &splits, max_views: None };
    let mut dataset = Dataset::open(root, &options)?;
    if !config.data.only_times.is_empty() {
        let times = only_times(root, &dataset.train.times(), &config.data.only_times)?;
        dataset.train = at_times(dataset.train, &times);
        dataset.test = dataset.test.map(|test| near(test, &times));
    }
    check_counts(root, &dataset.train, &config.data)?;
    dataset.train = thinned(dataset.train, config.data.times, config.data.views_per_time);
    Ok(dataset)
}

/// Opens the views of a split that a scene trained with `config` is evaluated on, at most `max_views`, evenly spaced:
/// all views, or with `data.only_times` those nearest to the training times. `normalisation` as for [`read_split`].
///
/// # Errors
/// If the split, or with `data.only_times` the list of training views, cannot be read.
pub fn open_measured(
    root: &Path,
    name: SplitName,
    config: &Config,
    max_views: Option<usize>,
    normalisation: Option<Normalisation>,
) -> Result<Split, DataError> {
    if config.data.only_times.is_empty() {
        return read_split(root, name, config.data.downscale, max_views, normalisation);
    }
    let split = read_split(root, name, config.data.downscale, None, normalisation)?;
    // without training views, the requested times are used
    let times = match SplitName::Train.json_path(root).exists() {
        true => {
            let options = OpenOptions { downscale: config.data.downscale, splits: &[], max_views: None };
            only_times(root, &Dataset::open(root, &options)?.train.times(), &config.data.only_times)?
        }
        false => config.data.only_times.clone(),
    };
    let split = near(split, &times);
    Ok(match max_views {
        Some(count) => evenly(split, count),
        None => split,
    })
}

/// Opens a random sample of at most `most` of the views that a scene was trained on with `config`, with their images,
/// and returns it with the number of all such views. The sample is the same for every run on the dataset.
///
/// # Errors
/// If the training views cannot be read, or two of `data.only_times` select the same time.
pub fn open_trained(root: &Path, config: &Config, most: usize) -> Result<(Split, usize), DataError> {
    let options = OpenOptions { downscale: config.data.downscale, splits: &[], max_views: None };
    let mut split = Dataset::open(root, &options)?.train;
    let all = split.paths();
    if !config.data.only_times.is_empty() {
        let times = only_times(root, &split.times(), &config.data.only_times)?;
        split = at_times(split, &times);
    }
    let mut split = thinned(split, config.data.times, config.data.views_per_time);
    let of = split.frames.len();
    if of > most {
        let mut order: Vec<usize> = (0..of).collect();
        Rng::new(0, 0, Purpose::MeasuredViews).shuffle(&mut order);
        order.truncate(most);
        order.sort_unstable();
        split.frames = order.into_iter().map(|i| split.frames[i].clone()).collect();
    }
    let paths = split.paths();
    let json = SplitName::Train.json_path(root);
    split.images = ImageSet::load(&json, &paths, config.data.downscale).map_err(|e| {
        let kept: Vec<usize> = paths.iter().filter_map(|path| all.iter().position(|p| p == path)).collect();
        renumber(e, &kept)
    })?;
    Ok((split, of))
}

/// Returns the times in [0, 1] that `config` trains on; `data` may have been opened with or without its images.
pub fn trained_times(data: &Dataset, config: &Config) -> Vec<f64> {
    if config.data.only_times.is_empty() {
        // the number of views per time does not matter
        return thinned(data.train.clone(), config.data.times, 1).times();
    }
    nearest_times(&data.train.times(), &config.data.only_times)
}

/// Keeps the views of `split` at those of its times that are nearest to `times`.
fn near(split: Split, times: &[f64]) -> Split {
    let nearest = nearest_times(&split.times(), times);
    at_times(split, &nearest)
}

/// Refuses to train on fewer times or views than asked for: a variant of a sweep that raises their number would train its
/// baseline.
fn check_counts(root: &Path, train: &Split, data: &DataConfig) -> Result<(), DataError> {
    let times = train.times();
    let views = |time: &f64| train.frames.iter().filter(|f| f.time == *time).count();
    let most = times.iter().map(views).max().unwrap_or(0);
    let counts = [
        ("data.times", data.times, format!("there are {} training times", times.len()), times.len()),
        ("data.views_per_time", data.views_per_time, format!("no training time has more than {most} views"), most),
    ];
    match counts.into_iter().find(|(_, asked, _, there)| asked > there) {
        None => Ok(()),
        Some((option, asked, problem, there)) => Err(DataError::Option {
            path: SplitName::Train.json_path(root),
            option,
            problem: format!("{asked}, but {problem}"),
            hint: format!("set it to at most {there}, or to 0 for all"),
        }),
    }
}

/// Returns the training times that `data.only_times` selects.
fn only_times(root: &Path, all: &[f64], wanted: &[f64]) -> Result<Vec<f64>, DataError> {
    let chosen = nearest_times(all, wanted);
    let twice = (0..chosen.len()).find_map(|i| (0..i).find(|&j| chosen[j] == chosen[i]).map(|j| (j, i)));
    match twice {
        None => Ok(chosen),
        Some((a, b)) => Err(DataError::Option {
            path: SplitName::Train.json_path(root),
            option: "data.only_times",
            problem: format!("{} and {} both choose the training time {}", wanted[a], wanted[b], chosen[a]),
            hint: "remove one of them, or give times that are farther apart".to_owned(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::fixture::write_sphere_dataset;

    #[test]
    fn only_times_are_trained_on_and_measured() {
        let folder = tempfile::tempdir().unwrap();
        write_sphere_dataset(folder.path(), 6, 8).unwrap(); // three views at time 0, three at time 1, in both splits
        let mut config = Config::default();
        config.data.only_times = vec![0.7];
        let data = open_dataset(folder.path(), &config).unwrap();
        assert_eq!((data.train.times(), data.train.frames.len(), data.train.images.len()), (vec![1.0], 3, 3));
        assert_eq!(data.test.map(|t| (t.times(), t.frames.len())), Some((vec![1.0], 3)));
        let measured = |views| open_measured(folder.path(), SplitName::Test, &config, views, None).unwrap();
        assert_eq!((measured(None).times(), measured(None).frames.len()), (vec![1.0], 3));
        assert_eq!((measured(Some(2)).times(), measured(Some(2)).images.len()), (vec![1.0], 2));
        assert_eq!(trained_times(&open_dataset(folder.path(), &Config::default()).unwrap(), &config), [1.0]);
        config.data.views_per_time = 2;
        assert_eq!(open_dataset(folder.path(), &config).unwrap().train.frames.len(), 2);
        // the fingerprint is that of the whole dataset, whatever is selected
        let whole = open_dataset(folder.path(), &Config::default()).unwrap();
        assert_eq!((whole.train.frames.len(), whole.fingerprint()), (6, data_fingerprint(folder.path(), &config)));
    }

    fn data_fingerprint(root: &Path, config: &Config) -> String {
        open_dataset(root, config).unwrap().fingerprint()
    }

    #[test]
    fn a_sample_of_what_was_trained_on_is_the_same_each_time() {
        let folder = tempfile::tempdir().unwrap();
        write_sphere_dataset(folder.path(), 6, 8).unwrap();
        let config = Config::default();
        let (all, of) = open_trained(folder.path(), &config, 6).unwrap();
        assert_eq!((&all, of), (&open_dataset(folder.path(), &config).unwrap().train, 6));
        let (some, of) = open_trained(folder.path(), &config, 4).unwrap();
        assert_eq!((some.frames.len(), some.images.len(), of), (4, 4, 6));
        assert_eq!(open_trained(folder.path(), &config, 4).unwrap().0, some);
        let at: Vec<usize> = some.frames.iter().map(|f| all.frames.iter().position(|a| a == f).unwrap()).collect();
        let size = all.images.pixels.len() / 6;
        for (k, i) in at.into_iter().enumerate() {
            assert_eq!(some.images.pixels[k * size..][..size], all.images.pixels[i * size..][..size]);
        }
        let mut config = Config::default();
        (config.data.only_times, config.data.views_per_time) = (vec![0.7], 2);
        let (some, of) = open_trained(folder.path(), &config, 4).unwrap();
        assert_eq!((some.times(), some.frames.len(), of), (vec![1.0], 2, 2));
        let last = some.frames.last().unwrap();
        let index = all.frames.iter().position(|f| f == last).unwrap();
        std::fs::write(&last.path, "no image").unwrap();
        let error = open_trained(folder.path(), &config, 4).unwrap_err();
        assert!(matches!(error, DataError::Image { frame, .. } if frame == index && index > 2), "{error}");
    }

    #[test]
    fn more_times_or_views_than_there_are_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        write_sphere_dataset(folder.path(), 6, 8).unwrap(); // three views at each of two times
        let open = |times: usize, views: usize| {
            let mut config = Config::default();
            (config.data.times, config.data.views_per_time) = (times, views);
            open_dataset(folder.path(), &config).map(|data| data.train.frames.len()).map_err(|e| e.to_string())
        };
        assert_eq!([open(2, 3), open(1, 2), open(0, 0)], [Ok(6), Ok(2), Ok(6)]);
        for (asked, words) in [
            ((3, 0), ["data.times", "3, but there are 2 training times", "at most 2"]),
            ((0, 4), ["data.views_per_time", "4, but no training time has more than 3 views", "at most 3"]),
        ] {
            let error = open(asked.0, asked.1).unwrap_err();
            assert!(words.iter().all(|w| error.contains(w)) && error.contains("transforms_train.json"), "{error}");
        }
    }

    #[test]
    fn two_that_choose_the_same_time_are_named() {
        let folder = tempfile::tempdir().unwrap();
        write_sphere_dataset(folder.path(), 6, 8).unwrap();
        let mut config = Config::default();
        config.data.only_times = vec![0.1, 0.9, 0.3];
        let error = open_dataset(folder.path(), &config).unwrap_err().to_string();
        assert!(
            error.contains("data.only_times") && error.contains("0.1 and 0.3 both choose the training time 0"),
            "{error}"
        );
    }
}
