//! What the presets of all methods have in common.

use crate::fourdgs::FourDgsConfig;
use crate::{check, layers, preset, presets};
use toml::{Table, Value};
use volseggs_core::config::types::{Config, D3dgsConfig, LossKind};

#[test]
fn every_preset_passes_and_is_shallow() {
    for (name, text) in presets() {
        check(&preset(name).unwrap()).unwrap_or_else(|e| panic!("{name}: {e}"));
        volseggs_base::nesting::check_toml(text).unwrap();
    }
}

#[test]
fn the_defaults_of_other_methods_are_their_published_settings() {
    assert_eq!(preset("d3dgs").unwrap().section(), Ok(D3dgsConfig::default()));
    assert_eq!(preset("4dgs").unwrap().section(), Ok(FourDgsConfig::default()));
}

#[test]
fn small_presets_are_of_their_method() {
    for name in ["d3dgs", "4dgs"] {
        let small = preset(&format!("{name}-small")).unwrap();
        assert_eq!((small.method.as_str(), small.loss.kind), (name, LossKind::L1));
    }
}

#[test]
fn presets_state_only_what_they_change() {
    fn walk(place: &str, stated: &Table, base: Option<&Table>, same: &mut Vec<String>) {
        for (key, value) in stated {
            let (place, before) = (format!("{place}.{key}"), base.and_then(|base| base.get(key)));
            match value {
                Value::Table(inner) => walk(&place, inner, before.and_then(Value::as_table), same),
                value if before == Some(value) => same.push(place),
                _ => {}
            }
        }
    }
    for (name, text) in presets().iter().filter(|(name, _)| *name != "paper") {
        let mut stated: Table = text.parse().unwrap();
        let layers = match stated.remove("extends") {
            Some(base) => layers().source(base.as_str().unwrap()),
            None => layers(),
        };
        let mut same = Vec::new();
        walk(name, &stated, Some(&layers.resolve::<Config>().unwrap().table), &mut same);
        assert!(same.is_empty(), "what they start from has these values already: {same:?}");
    }
}
