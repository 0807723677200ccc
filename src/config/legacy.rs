//! Values implied for keys that a run's configuration predates, where the key's default would change the run.

use super::types::Config;
use super::types::defaults::dilation_of_3dgs;
use toml::{Table, Value};

/// The keys missing from `run`, a whole resolved configuration, with the values that it was trained with.
///
/// Formerly, the warm-up rate decayed over the length of the joint stage and warm-up densified until its end; Gaussians
/// had no embedding, were all dilated as in 3DGS, had harmonics of all bands and opacities that are the same from all
/// sides, and were saved as the last step left them.
pub fn implied(run: &Table) -> Vec<(&'static str, Value)> {
    let number = |section: &str, key: &str| run.get(section)?.get(key)?.as_integer();
    let lacks = |section: &str, key: &str| run.get(section).is_some_and(|s| s.get(key).is_none());
    let mut found = Vec::new();
    if let (true, Some(steps)) = (lacks("optim", "warmup_decay_steps"), number("stages", "joint_steps")) {
        found.push(("optim.warmup_decay_steps", steps.max(1).into()));
    }
    let until = Config::default().densify.warmup_until as i64;
    if let (true, Some(steps)) = (lacks("densify", "warmup_until"), number("stages", "warmup_steps"))
        && steps > until
    {
        found.push(("densify.warmup_until", steps.into()));
    }
    if lacks("model", "embedding") {
        found.push(("model.embedding", 0.into()));
    }
    if lacks("model", "dilation") {
        found.push(("model.dilation", dilation_of_3dgs().into()));
    }
    if lacks("model", "path_opacity") {
        found.push(("model.path_opacity", 0.0.into()));
    }
    if lacks("model", "sh_bands") {
        found.push(("model.sh_bands", "all".into()));
    }
    if lacks("optim", "average") {
        found.push(("optim.average", 0.into()));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_missing_keys_are_implied() {
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
        assert_eq!(implied(&old), [("optim.warmup_decay_steps", 1.into()), ("densify.warmup_until", 30_000.into())]);
        old["stages"]["warmup_steps"] = 400.into();
        old["stages"]["joint_steps"] = 9000.into();
        assert_eq!(implied(&old), [("optim.warmup_decay_steps", 9000.into())]);
        old["model"].as_table_mut().unwrap().remove("embedding");
        assert_eq!(implied(&old)[1..], [("model.embedding", 0.into())]);
        old["model"].as_table_mut().unwrap().remove("dilation");
        assert_eq!(implied(&old)[2..], [("model.dilation", 0.3.into())]);
        old["model"].as_table_mut().unwrap().remove("path_opacity");
        assert_eq!(implied(&old)[3..], [("model.path_opacity", 0.0.into())]);
        old["model"].as_table_mut().unwrap().remove("sh_bands");
        assert_eq!(implied(&old)[4..], [("model.sh_bands", "all".into())]);
        old["optim"].as_table_mut().unwrap().remove("average");
        assert_eq!(implied(&old)[5..], [("optim.average", 0.into())]);
        assert_eq!(implied(&Table::new()), []);
    }
}
