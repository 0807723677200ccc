//! Where leaves come from: files and presets with `extends`, the environment, `--set`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::schema::SchemaNode;
use super::text::dotted;
use super::{ConfigError, KeyOrigin};

/// A key path with its value. Tables are flattened, so a value is a table only if empty.
#[derive(Debug, Clone)]
pub(super) struct Leaf {
    pub(super) path: Vec<String>,
    pub(super) value: Value,
    pub(super) origin: KeyOrigin,
}

/// Appends the leaves of `value` at `path`; `origin` gives the origin of each leaf.
pub(super) fn flatten(
    path: &mut Vec<String>,
    value: Value,
    origin: &dyn Fn(&[String]) -> KeyOrigin,
    out: &mut Vec<Leaf>,
) {
    match value {
        Value::Table(table) if !table.is_empty() => {
            for (key, value) in table {
                path.push(key);
                flatten(path, value, origin, out);
                path.pop();
            }
        }
        value => out.push(Leaf { path: path.clone(), value, origin: origin(path) }),
    }
}

enum SourceLocation {
    File(PathBuf),
    Preset(usize),
}

/// Reads files and presets, bases first.
pub(super) struct SourceReader<'a> {
    presets: &'a [(&'a str, &'a str)],
    open: Vec<String>,
}

fn stem(name: &str) -> &str {
    name.strip_suffix(".toml").unwrap_or(name)
}

impl<'a> SourceReader<'a> {
    pub(super) fn new(presets: &'a [(&'a str, &'a str)]) -> Self {
        Self { presets, open: Vec::new() }
    }

    /// Appends the leaves of the file or preset `name`, looked up in `dir` first (`None`: presets only).
    pub(super) fn read(
        &mut self,
        name: &str,
        dir: Option<&Path>,
        wanted_by: &str,
        out: &mut Vec<Leaf>,
    ) -> Result<(), ConfigError> {
        let (id, text, dir, path) = match self.find(name, dir, wanted_by)? {
            SourceLocation::File(path) => {
                let text = crate::files::read_settings(&path)
                    .map_err(|source| ConfigError::Read { path: path.clone(), source })?;
                let id = path.canonicalize().unwrap_or_else(|_| path.clone());
                let dir = path.parent().map(Path::to_path_buf);
                (id.display().to_string(), text, dir, Some(path))
            }
            SourceLocation::Preset(index) => {
                let (name, text) = self.presets[index];
                (format!("preset {}", stem(name)), text.to_owned(), None, None)
            }
        };
        let place = path.as_ref().map_or_else(|| id.clone(), |p| p.display().to_string());
        if self.open.contains(&id) {
            self.open.push(id);
            return Err(ConfigError::Cycle(self.open.join(" -> ")));
        }
        self.open.push(id);
        let syntax = |error: toml::de::Error| ConfigError::Syntax {
            place: place.clone(),
            message: error.to_string().trim_end().to_owned(),
        };
        crate::nesting::check_toml(&text).map_err(|message| ConfigError::Syntax { place: place.clone(), message })?;
        let mut table: Table = text.parse().map_err(syntax)?;
        let spans = DeTable::parse(&text).map_err(syntax)?;
        let lines = lines_of(&text, spans.get_ref());
        let origin = |key: &[String]| {
            let line = lines.get(key).copied().unwrap_or(1);
            match &path {
                Some(path) => KeyOrigin::File { path: path.clone(), line },
                None => KeyOrigin::Preset { name: stem(name).to_owned(), line },
            }
        };
        match table.remove("extends") {
            None => {}
            Some(Value::String(base)) => {
                self.read(&base, dir.as_deref(), &format!("{place}: `extends`"), out)?;
            }
            Some(_) => return Err(ConfigError::Extends(origin(&["extends".to_owned()]))),
        }
        if !table.is_empty() {
            flatten(&mut Vec::new(), Value::Table(table), &origin, out);
        }
        self.open.pop();
        Ok(())
    }

    fn find(&self, name: &str, dir: Option<&Path>, by: &str) -> Result<SourceLocation, ConfigError> {
        if let Some(dir) = dir {
            let path = dir.join(name);
            let with_suffix = dir.join(format!("{name}.toml"));
            if let Some(file) = [path, with_suffix].into_iter().find(|p| p.is_file()) {
                return Ok(SourceLocation::File(file));
            }
        }
        let preset = |(known, _): &(&str, &str)| stem(known) == stem(name);
        if let Some(index) = self.presets.iter().position(preset) {
            return Ok(SourceLocation::Preset(index));
        }
        let known: Vec<&str> = self.presets.iter().map(|(name, _)| stem(name)).collect();
        Err(ConfigError::NotFound {
            name: name.to_owned(),
            wanted_by: by.to_owned(),
            known: if known.is_empty() { "none".to_owned() } else { known.join(", ") },
        })
    }
}

/// The line, from 1, of each key of a document.
fn lines_of(text: &str, table: &DeTable<'_>) -> BTreeMap<Vec<String>, usize> {
    fn walk(ends: &[usize], at: &mut Vec<String>, table: &DeTable<'_>, out: &mut BTreeMap<Vec<String>, usize>) {
        for (key, value) in table {
            at.push(key.get_ref().to_string());
            if let DeValue::Table(inner) = value.get_ref() {
                walk(ends, at, inner, out);
            }
            out.insert(at.clone(), 1 + ends.partition_point(|end| *end < key.span().start));
            at.pop();
        }
    }
    // positions of the line ends
    let ends: Vec<usize> = text.bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(i, _)| i).collect();
    let mut out = BTreeMap::new();
    walk(&ends, &mut Vec::new(), table, &mut out);
    out
}

/// Parses a value typed by hand: TOML if it parses as TOML, text otherwise; always text where the configuration accepts
/// only text, so that a name such as `2024` needs no quotes.
fn parse_value(text: &str, node: Option<&SchemaNode<'_>>) -> Value {
    let plain = || Value::String(text.to_owned());
    if crate::nesting::check_toml(text).is_err() {
        return plain();
    }
    match text.trim().parse::<Value>() {
        Ok(Value::String(inner)) => Value::String(inner),
        Ok(_) if node.is_some_and(SchemaNode::is_text) => plain(),
        Ok(value) => value,
        Err(_) => plain(),
    }
}

fn node_at<'a>(root: &SchemaNode<'a>, path: &[String]) -> Option<SchemaNode<'a>> {
    path.iter().try_fold(root.clone(), |node, key| node.child(key))
}

/// Appends the leaves of one `a.b=value`.
pub(super) fn parse_set(text: &str, root: &SchemaNode<'_>, out: &mut Vec<Leaf>) -> Result<(), ConfigError> {
    let wrong = || ConfigError::Override(text.to_owned());
    let (key, value) = text.split_once('=').ok_or_else(wrong)?;
    let mut path: Vec<String> = key.split('.').map(|part| part.trim().to_owned()).collect();
    if path.iter().any(String::is_empty) {
        return Err(wrong());
    }
    let value = parse_value(value, node_at(root, &path).as_ref());
    flatten(&mut path, value, &|_| KeyOrigin::Set, out);
    Ok(())
}

/// Appends the leaves of one environment variable; `key` is its name without the prefix.
pub(super) fn parse_env(
    name: &str,
    key: &str,
    value: &str,
    root: &SchemaNode<'_>,
    out: &mut Vec<Leaf>,
) -> Result<(), ConfigError> {
    let mut path: Vec<String> = key.split("__").map(str::to_lowercase).collect();
    if path.iter().any(String::is_empty) {
        return Err(ConfigError::Env {
            name: name.to_owned(),
            reason: "expected a key with `__` for each dot, such as VOLSEGGS_LOSS__DSSIM".to_owned(),
        });
    }
    let value = parse_value(value, node_at(root, &path).as_ref());
    flatten(&mut path, value, &|_| KeyOrigin::Env(name.to_owned()), out);
    Ok(())
}

/// Returns an error if the configuration does not have the leaf's path.
pub(super) fn check_known(leaf: &Leaf, root: &SchemaNode<'_>) -> Result<(), ConfigError> {
    if node_at(root, &leaf.path).is_some() {
        return Ok(());
    }
    let mut known = Vec::new();
    root.keys("", 0, &mut known);
    let key = dotted(&leaf.path);
    Err(ConfigError::UnknownKey { origin: leaf.origin.clone(), suggestion: super::schema::closest(&key, &known), key })
}
