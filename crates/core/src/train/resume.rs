//! Which keys of a configuration may change when a run resumes from a checkpoint.
//!
//! Logs, evaluations, checkpoints, the moving average and segmentation affect no step, so `output.*`, `optim.average` and
//! `segment.*` may change.
//! `stages.joint_steps` may grow: a trained run can be lengthened. The schedules then follow the new length from the
//! next step on (a rate that had fallen to its end rises to its value in the longer schedule, and a late DSSIM moves to
//! the new end), so a lengthened run differs from a run of that length from the start.

use crate::config::flatten;
use crate::config::sections;
use std::collections::BTreeMap;
use std::fmt;
use toml::{Table, Value};

/// Key of the length of joint training.
const LENGTH: &str = "stages.joint_steps";

/// Key of the moving average.
pub(super) const AVERAGE: &str = "optim.average";

/// A key whose value differs from the checkpoint's.
#[derive(Clone, Debug, PartialEq)]
pub struct ChangedKey {
    /// The key.
    pub key: String,
    /// Its value in the checkpoint.
    pub was: String,
    /// Its value now.
    pub now: String,
    /// Why it may not change; `None` if it may.
    pub refused: Option<String>,
}

impl fmt::Display for ChangedKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { key, was, now, refused } = self;
        write!(f, "{key} was {was} and is {now} now")?;
        refused.as_ref().map_or(Ok(()), |why| write!(f, " ({why})"))
    }
}

/// Returns the keys in which two resolved configurations (TOML) differ, first those that may change and then those that
/// may not, for a checkpoint after `step` steps.
///
/// # Errors
/// If the checkpoint's configuration cannot be read.
pub fn changes(was: &str, now: &str, step: usize) -> Result<(Vec<ChangedKey>, Vec<ChangedKey>), String> {
    let (old, new) = (flat(was)?, flat(now)?);
    let shown = |v: Option<&Value>| v.map_or_else(|| "not set".to_owned(), ToString::to_string);
    let keys: std::collections::BTreeSet<&String> = old.keys().chain(new.keys()).collect();
    let mut found = (Vec::new(), Vec::new());
    for key in keys {
        let (before, after) = (old.get(key), new.get(key));
        if before == after {
            continue;
        }
        let refused = refusal(key, before, after, step);
        let change = ChangedKey { key: key.clone(), was: shown(before), now: shown(after), refused };
        if change.refused.is_none() { found.0.push(change) } else { found.1.push(change) }
    }
    Ok(found)
}

fn refusal(key: &str, before: Option<&Value>, after: Option<&Value>, step: usize) -> Option<String> {
    let free = ["output.", "segment."].iter().any(|section| key.starts_with(section));
    if free || key == AVERAGE || sections::may_change(key) {
        return None;
    }
    if key == LENGTH {
        let number = |v: Option<&Value>| v.and_then(Value::as_integer).unwrap_or(0);
        let longer = number(after) >= number(before);
        return (!longer).then(|| "a run can be lengthened, not shortened; --stop-after ends it early".to_owned());
    }
    Some(format!("it shaped the {step} steps already taken"))
}

/// Returns every key with its value.
fn flat(text: &str) -> Result<BTreeMap<String, Value>, String> {
    let table: Table = text.parse().map_err(|e: toml::de::Error| format!("configuration: {}", e.message()))?;
    Ok(flatten(&table))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::sections::{ConfigSection, Settings};
    use crate::config::types::Config;
    use schemars::JsonSchema;
    use serde::{Deserialize, Serialize};

    #[derive(Default, Serialize, Deserialize, JsonSchema)]
    #[serde(default)]
    struct Moved {
        file: String,
    }

    impl Settings for Moved {
        const SECTION: &'static str = "test-moved";
        const MAY_CHANGE: &'static [&'static str] = &["file"];
    }

    fn text(edit: impl Fn(&mut Config)) -> String {
        let mut config = Config::default();
        edit(&mut config);
        toml::to_string(&config).unwrap()
    }

    #[test]
    fn logs_and_length_may_change_and_other_changes_are_named() {
        let base = text(|_| ());
        assert_eq!(changes(&base, &base, 5).unwrap(), (Vec::new(), Vec::new()));
        ConfigSection::new::<Moved>().add();
        let (moved, refused) = changes("[test-moved]\nfile = 'a'", "[test-moved]\nfile = 'b'", 5).unwrap();
        assert_eq!((moved[0].key.as_str(), refused.len()), ("test-moved.file", 0), "the file may have moved");
        let more = text(|c| {
            c.output.log_every = 7;
            c.segment.layers.join = false;
            c.optim.average = 500;
            c.stages.joint_steps += 500;
        });
        let (allowed, refused) = changes(&base, &more, 5).unwrap();
        assert_eq!(refused, []);
        assert_eq!(
            allowed.iter().map(|c| c.key.as_str()).collect::<Vec<_>>(),
            [AVERAGE, "output.log_every", "segment.layers.join", LENGTH]
        );
        let (_, refused) = changes(&more, &base, 5).unwrap();
        assert!(refused[0].to_string().contains("not shortened"), "{}", refused[0]);
        let other = text(|c| {
            c.seed = 9;
            c.loss.extra.insert("mine".into(), 0.5);
        });
        let (_, refused) = changes(&base, &other, 5).unwrap();
        let messages: Vec<String> = refused.iter().map(ToString::to_string).collect();
        assert!(messages[0].contains("loss.extra.mine was not set and is 0.5 now"), "{messages:?}");
        assert!(messages[1].contains("seed was 0 and is 9 now (it shaped the 5 steps already taken)"), "{messages:?}");
    }

    #[test]
    fn a_checkpoint_without_a_configuration_is_refused() {
        assert!(changes("a = [", &text(|_| ()), 5).is_err());
    }
}
