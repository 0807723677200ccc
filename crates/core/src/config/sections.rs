//! Sections of the configuration that are not read by every method: each belongs to the code that reads it, which adds it
//! here by name. The schema and the layers then know its keys.

use crate::registry::Registry;
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;
use std::borrow::Cow;
use std::collections::BTreeMap;

static SECTIONS: Registry<ConfigSection> = Registry::new("section", &[]);

/// The settings of a section: a struct whose default holds the value of every key, for `#[serde(default)]`.
pub trait Settings: Serialize + DeserializeOwned + JsonSchema + 'static {
    /// The section's name.
    const SECTION: &'static str;
    /// Its keys that may change when a run resumes, as no step depends on them, such as where a file lies.
    const MAY_CHANGE: &'static [&'static str] = &[];
}

/// The schema of a section, and how missing keys get their defaults.
#[derive(Clone, Copy)]
pub struct ConfigSection {
    name: &'static str,
    schema: fn(&mut SchemaGenerator) -> Schema,
    complete: fn(Value) -> Result<Value, serde_json::Error>,
    may_change: &'static [&'static str],
}

impl ConfigSection {
    /// The section of these settings.
    pub const fn new<S: Settings>() -> Self {
        let schema = |generator: &mut SchemaGenerator| generator.subschema_for::<S>();
        let complete = |value: Value| serde_json::to_value(serde_json::from_value::<S>(value)?);
        Self { name: S::SECTION, schema, complete, may_change: S::MAY_CHANGE }
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        self.name
    }

    /// Makes configurations accept the section.
    pub fn add(self) {
        if SECTIONS.get(self.name).is_err() {
            SECTIONS.insert(self.name, Box::new(self));
        }
    }
}

/// Whether a key, such as `section.key`, is one of a section that may change when a run resumes.
pub fn may_change(key: &str) -> bool {
    let Some((section, key)) = key.split_once('.') else { return false };
    SECTIONS.get(section).is_ok_and(|section| section.may_change.contains(&key))
}

/// The sections that a configuration gives, each with all of its keys.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Sections(BTreeMap<String, Value>);

impl Sections {
    /// Returns the settings of a section; `None` if it is not given.
    ///
    /// # Errors
    /// If a value of it is of the wrong type.
    pub fn get<S: Settings>(&self) -> Result<Option<S>, String> {
        let read = |value: &Value| S::deserialize(value).map_err(|e| format!("[{}]: {e}", S::SECTION));
        self.0.get(S::SECTION).map(read).transpose()
    }

    /// Gives a section, in place of any that was given before.
    pub fn set<S: Settings>(&mut self, settings: &S) {
        // a struct of numbers, texts and lists always has a JSON form
        self.0.insert(S::SECTION.to_owned(), serde_json::to_value(settings).unwrap_or_default());
    }

    /// Removes the section of that name, if it is given.
    pub fn remove(&mut self, name: &str) {
        self.0.remove(name);
    }

    /// The names of the sections that are given, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }
}

impl<'de> Deserialize<'de> for Sections {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut sections = BTreeMap::<String, Value>::deserialize(deserializer)?;
        for (name, value) in &mut sections {
            match SECTIONS.get(name) {
                Ok(section) => *value = (section.complete)(value.take()).map_err(D::Error::custom)?,
                // the section of a method that this program lacks is kept as it is
                Err(_) if value.is_object() => {}
                Err(_) => return Err(D::Error::custom(format!("unknown field `{name}`"))),
            }
        }
        Ok(Self(sections))
    }
}

impl JsonSchema for Sections {
    fn schema_name() -> Cow<'static, str> {
        "Sections".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let properties =
            SECTIONS.all().into_iter().map(|(name, section)| (name, (section.schema)(generator).to_value()));
        let properties: serde_json::Map<String, Value> = properties.collect();
        schemars::json_schema!({ "type": "object", "properties": properties })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::layers::{ConfigError, Layers};
    use crate::config::types::Config;

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
    #[serde(deny_unknown_fields, default)]
    struct Waves {
        count: usize,
        height: f64,
    }

    impl Default for Waves {
        fn default() -> Self {
            Self { count: 3, height: 0.5 }
        }
    }

    impl Settings for Waves {
        const SECTION: &'static str = "test-waves";
    }

    fn resolve(set: &str) -> Result<Config, ConfigError> {
        Layers::new(&[]).sets([set.to_owned()]).resolve::<Config>().map(|resolved| resolved.value)
    }

    #[test]
    fn an_added_section_has_its_defaults_and_its_errors() {
        let unknown = resolve("test-waves.count=2").unwrap_err().to_string();
        assert!(unknown.contains("test-waves"), "{unknown}");
        ConfigSection::new::<Waves>().add();
        let config = resolve("test-waves.count=2").unwrap();
        assert_eq!(config.sections.get::<Waves>(), Ok(Some(Waves { count: 2, height: 0.5 })));
        let read: Config = toml::from_str(&toml::to_string(&config).unwrap()).unwrap();
        assert_eq!(read, config);
        for (set, words) in [("test-waves.cuont=2", "count"), ("test-waves.count=-1", "0 or above")] {
            let refused = resolve(set).unwrap_err().to_string();
            assert!(refused.contains("test-waves.") && refused.contains(words), "{refused}");
        }
        let mut without = config;
        without.sections.remove("test-waves");
        assert_eq!(without, Config::default());
    }

    #[test]
    fn a_section_of_another_program_is_kept_and_a_key_outside_of_sections_is_not() {
        let text = toml::to_string(&Config::default()).unwrap();
        let config: Config = toml::from_str(&format!("{text}\n[test-gone]\nsize = 2\n")).unwrap();
        assert_eq!(config.sections.names().collect::<Vec<_>>(), ["test-gone"]);
        let error = toml::from_str::<Config>(&format!("sede = 2\n{text}")).unwrap_err().to_string();
        assert!(error.contains("unknown field `sede`"), "{error}");
    }
}
