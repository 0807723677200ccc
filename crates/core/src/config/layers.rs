//! Layered configuration: defaults, then files or presets, then the environment, then `--set`.
//!
//! Generic over the configuration type. Every leaf keeps its origin, so that errors and the `show` text can state where
//! a value came from. No concrete option is named here.

mod error;
mod schema;
mod sources;
#[cfg(test)]
mod tests;
mod text;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

pub use error::{ConfigError, ValueError};
use schema::SchemaNode;
pub use schema::{file_schema, schema};
use sources::{Leaf, SourceReader};
use text::{dotted, one_line};

use crate::words::plain;

/// Prefix of the environment variables that set keys.
pub const ENV_PREFIX: &str = "VOLSEGGS_";

/// Where the value of a key came from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum KeyOrigin {
    /// The built-in default.
    Default,
    /// A file.
    File {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: usize,
    },
    /// A built-in preset.
    Preset {
        /// Its name without `.toml`.
        name: String,
        /// Its line, from 1.
        line: usize,
    },
    /// An environment variable.
    Env(String),
    /// An override on the command line.
    Set,
}

impl fmt::Display for KeyOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            // a control character in a file name must not end the comment in `show`
            Self::File { path, line } => {
                let path = path.display().to_string();
                write!(f, "file {}:{line}", path.replace(char::is_control, "?"))
            }
            Self::Preset { name, line } => write!(f, "preset {name}:{line}"),
            Self::Env(name) => write!(f, "env {name}"),
            Self::Set => f.write_str("--set"),
        }
    }
}

/// The layers of a configuration, in rising precedence: defaults, sources in the order given,
/// environment, `--set` in the order given.
#[derive(Debug, Clone, Default)]
pub struct Layers<'a> {
    presets: Cow<'a, [(&'a str, &'a str)]>,
    sources: Vec<String>,
    env: Vec<(String, String)>,
    sets: Vec<String>,
}

/// A configuration with the origin of each of its leaves.
#[derive(Debug, Clone)]
pub struct Resolved<T> {
    /// The configuration.
    pub value: T,
    /// The same as TOML; keys that are `None` are absent.
    pub table: Table,
    /// Origin of each leaf of `table` by its dotted key.
    pub origins: BTreeMap<String, KeyOrigin>,
}

impl<'a> Layers<'a> {
    /// Starts from the defaults alone; `presets` are the built-in files as (name, TOML text).
    pub fn new(presets: &'a [(&'a str, &'a str)]) -> Self {
        Self { presets: Cow::Borrowed(presets), ..Self::default() }
    }

    /// As [`Layers::new`], with presets that were put together for it.
    pub fn with_presets(presets: Vec<(&'a str, &'a str)>) -> Self {
        Self { presets: Cow::Owned(presets), ..Self::default() }
    }

    /// Adds a file, or a preset if no file `name` (or `name.toml`) exists.
    #[must_use]
    pub fn source(mut self, name: impl Into<String>) -> Self {
        self.sources.push(name.into());
        self
    }

    /// Adds overrides `a.b=value`. The value is TOML, or text where it does not parse as TOML.
    pub fn sets<S: Into<String>>(mut self, sets: impl IntoIterator<Item = S>) -> Self {
        self.sets.extend(sets.into_iter().map(Into::into));
        self
    }

    /// Adds the variables of `vars` (such as `std::env::vars_os()`) that start with [`ENV_PREFIX`], in name order.
    /// Names in `reserved` are used elsewhere and skipped; an entry ending in `*` matches any name with that prefix.
    ///
    /// # Errors
    /// [`ConfigError::Env`] for a variable with this prefix that is not UTF-8.
    pub fn env(
        mut self,
        vars: impl IntoIterator<Item = (OsString, OsString)>,
        reserved: &[&str],
    ) -> Result<Self, ConfigError> {
        for (name, value) in vars {
            let name = name.to_string_lossy().into_owned();
            let is = |known: &&str| known.strip_suffix('*').map_or(name == **known, |start| name.starts_with(start));
            if !name.starts_with(ENV_PREFIX) || reserved.iter().any(is) {
                continue;
            }
            let value = value
                .into_string()
                .map_err(|_| ConfigError::Env { name: name.clone(), reason: "the value is not UTF-8".to_owned() })?;
            self.env.push((name, value));
        }
        self.env.sort();
        Ok(self)
    }

    /// Merges the layers.
    ///
    /// # Errors
    /// If a source cannot be read, `extends` forms a cycle, a key is unknown or a value has the wrong type; the error
    /// names the origin and the key.
    pub fn resolve<T>(&self) -> Result<Resolved<T>, ConfigError>
    where
        T: Serialize + DeserializeOwned + Default + JsonSchema,
    {
        let schema = schema::<T>();
        let root = SchemaNode::root(&schema);
        let leaves = self.leaves(&root)?;
        for leaf in &leaves {
            sources::check_known(leaf, &root)?;
        }
        let defaults = to_table(&T::default(), &root)?;
        let mut merged = defaults.clone();
        for leaf in &leaves {
            put(&mut merged, &leaf.path, leaf.value.clone());
        }
        let value: T = match Value::Table(merged).try_into() {
            Ok(value) => value,
            Err(error) => return Err(blame::<T>(&leaves, &defaults, &error)),
        };
        let table = to_table(&value, &root)?;
        let mut written = Vec::new();
        let whole = Value::Table(table.clone());
        sources::flatten(&mut Vec::new(), whole, &|_| KeyOrigin::Default, &mut written);
        let mut origins = BTreeMap::new();
        for leaf in written.iter().filter(|leaf| !leaf.path.is_empty()) {
            // an empty section given later sets none of its leaves
            let sets_it = |given: &&Leaf| {
                leaf.path == given.path || !given.value.is_table() && leaf.path.starts_with(&given.path)
            };
            let last = leaves.iter().rev().find(sets_it);
            let origin = last.map_or(KeyOrigin::Default, |given| given.origin.clone());
            origins.insert(dotted(&leaf.path), origin);
        }
        Ok(Resolved { value, table, origins })
    }

    fn leaves(&self, root: &SchemaNode<'_>) -> Result<Vec<Leaf>, ConfigError> {
        let mut leaves = Vec::new();
        for name in &self.sources {
            let here = Some(Path::new(""));
            SourceReader::new(&self.presets).read(name, here, "configuration", &mut leaves)?;
        }
        for (name, value) in &self.env {
            let key = &name[ENV_PREFIX.len()..];
            sources::parse_env(name, key, value, root, &mut leaves)?;
        }
        for text in &self.sets {
            sources::parse_set(text, root, &mut leaves)?;
        }
        Ok(leaves)
    }
}

impl<T> Resolved<T> {
    /// Returns the value of a file that states every key, but for those of the section `optional`, such as the configuration
    /// in a run.
    ///
    /// # Errors
    /// [`ConfigError::Incomplete`], which names the first key that `file` lacks.
    pub fn complete(self, file: &Path, optional: &str) -> Result<T, ConfigError> {
        let needed = |key: &str| key.split('.').next() != Some(optional);
        match self.origins.into_iter().find(|(key, origin)| *origin == KeyOrigin::Default && needed(key)) {
            None => Ok(self.value),
            Some((key, _)) => Err(ConfigError::Incomplete { path: file.to_owned(), key }),
        }
    }

    /// The leaves in key order, one per line as `a.b = value  # origin`; the whole is valid TOML.
    pub fn show(&self) -> String {
        let mut leaves = Vec::new();
        let whole = Value::Table(self.table.clone());
        sources::flatten(&mut Vec::new(), whole, &|_| KeyOrigin::Default, &mut leaves);
        let mut text = String::new();
        for leaf in leaves.iter().filter(|leaf| !leaf.path.is_empty()) {
            let key = dotted(&leaf.path);
            let origin = self.origins.get(&key).unwrap_or(&KeyOrigin::Default);
            text += &format!("{key} = {}  # {origin}\n", one_line(&leaf.value));
        }
        text
    }

    /// The configuration as a TOML file that resolves to the same values.
    ///
    /// # Errors
    /// [`ConfigError::Defaults`] if a value has no TOML form.
    pub fn to_toml(&self) -> Result<String, ConfigError> {
        toml::to_string_pretty(&self.table).map_err(|e| ConfigError::Defaults(e.to_string()))
    }
}

fn to_table<T: Serialize>(value: &T, root: &SchemaNode<'_>) -> Result<Table, ConfigError> {
    let table = Table::try_from(value).map_err(|e| ConfigError::Defaults(e.to_string()))?;
    match tidy(Value::Table(table), Some(root)) {
        Value::Table(table) => Ok(table),
        _ => Ok(Table::new()),
    }
}

/// Gives `f32` values the shortest text that reads back as the same `f32`: 0.1, not
/// 0.10000000149011612.
fn tidy(value: Value, node: Option<&SchemaNode<'_>>) -> Value {
    match value {
        Value::Float(wide) if node.is_some_and(SchemaNode::is_f32) => {
            Value::Float((wide as f32).to_string().parse().unwrap_or(wide))
        }
        Value::Array(items) => {
            let node = node.and_then(SchemaNode::items);
            let tidied = items.into_iter().map(|item| tidy(item, node.as_ref()));
            Value::Array(tidied.collect())
        }
        Value::Table(table) => {
            let tidied = table.into_iter().map(|(key, value)| {
                let child = node.and_then(|node| node.child(&key));
                let value = tidy(value, child.as_ref());
                (key, value)
            });
            Value::Table(tidied.collect())
        }
        other => other,
    }
}

/// Puts a leaf into the table, replacing any non-table value on its path.
fn put(table: &mut Table, path: &[String], value: Value) {
    let Some((first, rest)) = path.split_first() else {
        return;
    };
    if rest.is_empty() {
        // an empty section sets nothing, so it must not erase the one from a lower layer
        let is_section = |value: &Value| value.as_table().is_some();
        if !(is_section(&value) && table.get(first).is_some_and(is_section)) {
            table.insert(first.clone(), value);
        }
        return;
    }
    let inner = table.entry(first.clone()).or_insert_with(|| Value::Table(Table::new()));
    if !inner.is_table() {
        *inner = Value::Table(Table::new());
    }
    if let Value::Table(inner) = inner {
        put(inner, rest, value);
    }
}

/// Finds the leaf that alone makes the defaults unreadable, since serde's error does not name the key.
fn blame<T: DeserializeOwned>(leaves: &[Leaf], defaults: &Table, whole: &toml::de::Error) -> ConfigError {
    for leaf in leaves.iter().rev() {
        let mut table = defaults.clone();
        put(&mut table, &leaf.path, leaf.value.clone());
        let Err(error) = Value::Table(table).try_into::<T>() else {
            continue;
        };
        // one key of an optional section does not make a complete section; that is not this key's fault
        if error.message().starts_with("missing field") {
            continue;
        }
        let default = leaf
            .path
            .split_first()
            .and_then(|(first, rest)| {
                let top = defaults.get(first)?;
                rest.iter().try_fold(top, |at, key| at.get(key))
            })
            .filter(|value| !value.is_table());
        return ConfigError::Value(Box::new(ValueError {
            origin: leaf.origin.clone(),
            key: dotted(&leaf.path),
            message: plain(error.message()),
            got: one_line(&leaf.value),
            default: default.map(one_line),
        }));
    }
    ConfigError::Inconsistent(plain(whole.message()))
}
