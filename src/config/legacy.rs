//! What the configuration of a run from before a key existed says of it, where the key's default would change the run.

use super::types::Config;
use toml::Table;

/// The keys that `run`, a whole resolved configuration, does not have, with the values that it was trained with.
///
/// Warm-up's rate used to fall over the length of the joint stage, and warm-up densified to its end; Gaussians had no embedding.
pub fn implied(run: &Table) -> Vec<(&'static str, i64)> {
    let number = |section: &str, key: &str| run.get(section)?.get(key)?.as_integer();
    let lacks = |section: &str, key: &str| run.get(section).is_some_and(|s| s.get(key).is_none());
    let mut found = Vec::new();
    if let (true, Some(steps)) = (lacks("optim", "warmup_decay_steps"), number("stages", "joint_steps")) {
        found.push(("optim.warmup_decay_steps", steps.max(1)));
    }
    let until = Config::default().densify.warmup_until as i64;
    if let (true, Some(steps)) = (lacks("densify", "warmup_until"), number("stages", "warmup_steps"))
        && steps > until
    {
        found.push(("densify.warmup_until", steps));
    }
    if lacks("model", "embedding") {
        found.push(("model.embedding", 0));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_missing_is_implied() {
        let table = |edit: fn(&mut Config)| {
            let mut config = Config::default();
            edit(&mut config);
            Table::try_from(config).unwrap()
        };
        let long = |c: &mut Config| (c.stages.warmup_steps, c.stages.joint_steps) = (30_000, 0);
        assert_eq!(implied(&table(long)), []);
        let mut old = table(long);
        for (section, key) in [("optim", "warmup_decay_steps"), ("densify", "warmup_until")] {
            old[section].as_table_mut().unwrap().remove(key);
        }
        assert_eq!(implied(&old), [("optim.warmup_decay_steps", 1), ("densify.warmup_until", 30_000)]);
        old["stages"]["warmup_steps"] = 400.into();
        old["stages"]["joint_steps"] = 9000.into();
        assert_eq!(implied(&old), [("optim.warmup_decay_steps", 9000)]);
        old["model"].as_table_mut().unwrap().remove("embedding");
        assert_eq!(implied(&old)[1..], [("model.embedding", 0)]);
        assert_eq!(implied(&Table::new()), []);
    }
}
