//! Which keys of a configuration may change when a run resumes from a checkpoint.
//!
//! Logs, evaluations, checkpoints, the moving average and segmentation affect no step, so `output.*`, `optim.average` and
//! `segment.*` may change.
//! `stages.joint_steps` may grow: a trained run can be lengthened. The schedules then follow the new length from the
//! next step on (a rate that had fallen to its end rises to its value in the longer schedule, and a late DSSIM moves to
//! the new end), so a lengthened run differs from a run of that length from the start.

use crate::config::legacy::implied;
use crate::config::types::Config;
use std::collections::BTreeMap;
use std::fmt;
use toml::{Table, Value};

/// Key of the length of joint training.
const LENGTH: &str = "stages.joint_steps";

/// Key of the moving average.
pub(super) const AVERAGE: &str = "optim.average";
/// The file of the VGG weights, which may have moved.
const VGG: &str = "insitunet.vgg";

/// Key of the encoder, and prefix of the keys that only the implicit encoder reads: their defaults have changed.
const ENCODER: &str = "model.encoder";
const IMPLICIT: &str = "model.implicit_";

/// A key whose value differs from the checkpoint's.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The key.
    pub key: String,
    /// Its value in the checkpoint.
    pub was: String,
    /// Its value now.
    pub now: String,
    /// Why it may not change; `None` if it may.
    pub refused: Option<String>,
}

impl fmt::Display for Change {
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
pub fn changes(was: &str, now: &str, step: usize) -> Result<(Vec<Change>, Vec<Change>), String> {
    let (old, new) = (flat(was)?, flat(now)?);
    let shown = |v: Option<&Value>| v.map_or_else(|| "not set".to_owned(), ToString::to_string);
    let keys: std::collections::BTreeSet<&String> = old.keys().chain(new.keys()).collect();
    let implicit = |all: &BTreeMap<String, Value>| all.get(ENCODER).and_then(Value::as_str) == Some("implicit");
    let read = implicit(&old) || implicit(&new);
    let mut found = (Vec::new(), Vec::new());
    for key in keys {
        if key.starts_with(IMPLICIT) && !read {
            continue;
        }
        let (before, after) = (old.get(key), new.get(key));
        if before == after {
            continue;
        }
        let refused = refusal(key, before, after, step);
        let change = Change { key: key.clone(), was: shown(before), now: shown(after), refused };
        if change.refused.is_none() { found.0.push(change) } else { found.1.push(change) }
    }
    Ok(found)
}

fn refusal(key: &str, before: Option<&Value>, after: Option<&Value>, step: usize) -> Option<String> {
    if ["output.", "segment."].iter().any(|section| key.starts_with(section)) || [AVERAGE, VGG].contains(&key) {
        return None;
    }
    if key == LENGTH {
        let number = |v: Option<&Value>| v.and_then(Value::as_integer).unwrap_or(0);
        let longer = number(after) >= number(before);
        return (!longer).then(|| "a run can be lengthened, not shortened; --stop-after ends it early".to_owned());
    }
    Some(format!("it shaped the {step} steps already taken"))
}

/// Returns every key with its value; a key that an early version did not write has its default, or the value that
/// matches what that version did.
fn flat(text: &str) -> Result<BTreeMap<String, Value>, String> {
    let table: Table = text.parse().map_err(|e: toml::de::Error| format!("configuration: {}", e.message()))?;
    let mut all = BTreeMap::new();
    if let Ok(Value::Table(defaults)) = Value::try_from(Config::default()) {
        flatten("", &defaults, &mut all);
    }
    all.extend(implied(&table).into_iter().map(|(key, value)| (key.to_owned(), value)));
    flatten("", &table, &mut all);
    Ok(all)
}

fn flatten(prefix: &str, table: &Table, all: &mut BTreeMap<String, Value>) {
    for (name, value) in table {
        let key = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        match value {
            Value::Table(inner) => flatten(&key, inner, all),
            value => drop(all.insert(key, value.clone())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::types::EncoderKind;

    fn text(edit: impl Fn(&mut Config)) -> String {
        let mut config = Config::default();
        edit(&mut config);
        toml::to_string(&config).unwrap()
    }

    #[test]
    fn logs_and_length_may_change_and_other_changes_are_named() {
        let base = text(|_| ());
        assert_eq!(changes(&base, &base, 5).unwrap(), (Vec::new(), Vec::new()));
        let (moved, refused) = changes("[insitunet]\nvgg = 'a'", "[insitunet]\nvgg = 'b'", 5).unwrap();
        assert_eq!((moved[0].key.as_str(), refused.len()), ("insitunet.vgg", 0), "the file may have moved");
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
    fn keys_that_no_encoder_of_the_run_reads_may_differ() {
        let of = |encoder: EncoderKind, octaves: usize| {
            text(|c| (c.model.encoder, c.model.implicit_octaves) = (encoder, octaves))
        };
        let (factorised, implicit) = (EncoderKind::Factorised, EncoderKind::Implicit);
        assert_eq!(changes(&of(factorised, 4), &of(factorised, 10), 5).unwrap(), (Vec::new(), Vec::new()));
        let (_, refused) = changes(&of(implicit, 4), &of(implicit, 10), 5).unwrap();
        assert!(refused[0].to_string().contains("model.implicit_octaves was 4 and is 10 now"), "{}", refused[0]);
        assert_eq!(changes(&of(factorised, 4), &of(implicit, 10), 5).unwrap().1.len(), 2);
    }

    #[test]
    fn a_key_that_an_early_version_did_not_write_has_its_default() {
        let base = text(|_| ());
        let old: String = base.lines().filter(|l| !l.starts_with("cull_visits")).map(|l| format!("{l}\n")).collect();
        assert_ne!(old, base);
        assert_eq!(changes(&old, &base, 5).unwrap(), (Vec::new(), Vec::new()));
        assert!(changes("a = [", &base, 5).is_err());
    }

    #[test]
    fn runs_older_than_the_warm_up_schedule_keep_their_schedule() {
        let without = |text: &str| -> String {
            text.lines().filter(|l| !l.starts_with("warmup_decay_steps")).map(|l| format!("{l}\n")).collect()
        };
        // `best`: the same as the default
        let best = text(|_| ());
        assert_eq!(changes(&without(&best), &best, 5).unwrap(), (Vec::new(), Vec::new()));
        // in a shorter run, rates fell over its own length
        let short = text(|c| c.stages.joint_steps = 9000);
        assert_eq!(changes(&without(&short), &without(&short), 5).unwrap(), (Vec::new(), Vec::new()));
        let (_, refused) = changes(&without(&short), &short, 5).unwrap();
        assert!(refused[0].to_string().contains("optim.warmup_decay_steps was 9000 and is 30000 now"), "{refused:?}");
    }
}
