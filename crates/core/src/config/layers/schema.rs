//! Views into a JSON schema: which keys exist, and of what type a leaf is.

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value as Json;

/// Depth beyond which a self-referencing schema is no longer expanded.
const MAX_DEPTH: usize = 16;

/// The JSON schema of `T`, for editors and documentation.
pub fn schema<T: JsonSchema>() -> Json {
    schemars::schema_for!(T).to_value()
}

/// The JSON schema of a configuration file for `T`: every key is optional, since the lower layers supply its value, and
/// `extends` names the file or preset to start from. Each key carries its value in `defaults`.
pub fn file_schema<T: JsonSchema + Serialize>(defaults: &T) -> Json {
    let mut schema = schema::<T>();
    relax(&mut schema);
    // a value that cannot be written as TOML leaves the schema without built-in values
    let defaults = super::to_table(defaults, &SchemaNode::root(&schema)).unwrap_or_default();
    fill(&mut schema, "", &serde_json::to_value(defaults).unwrap_or_default());
    if let Some(properties) = schema.get_mut("properties").and_then(Json::as_object_mut) {
        let description = "File or preset whose values this file starts from.";
        properties.insert("extends".into(), serde_json::json!({ "type": "string", "description": description }));
    }
    schema
}

fn relax(node: &mut Json) {
    match node {
        Json::Object(fields) => {
            fields.remove("required");
            fields.values_mut().for_each(relax);
        }
        Json::Array(items) => items.iter_mut().for_each(relax),
        _ => {}
    }
}

/// Writes the built-in value of each key of the section at the JSON pointer `section` into the schema. Sections have no
/// default of their own.
fn fill(schema: &mut Json, section: &str, defaults: &Json) {
    for (name, value) in defaults.as_object().into_iter().flatten() {
        // the section of another method is absent unless it is used
        let Some(Json::Object(node)) = schema.pointer_mut(&format!("{section}/properties/{name}")) else { continue };
        // a reference has the form `#/$defs/Name`, which is a pointer after its first character
        let reference = node.get("$ref").and_then(Json::as_str).and_then(|r| r.strip_prefix('#')).map(str::to_owned);
        match reference.filter(|_| value.is_object()) {
            Some(inner) => {
                node.remove("default");
                fill(schema, &inner, value);
            }
            None => drop(node.insert("default".into(), value.clone())),
        }
    }
}

/// A node of the schema: all alternatives that a value at this place may match.
#[derive(Debug, Clone)]
pub(super) struct SchemaNode<'a> {
    root: &'a Json,
    alternatives: Vec<&'a Json>,
}

impl<'a> SchemaNode<'a> {
    pub(super) fn root(root: &'a Json) -> Self {
        Self::of(root, root)
    }

    fn of(root: &'a Json, node: &'a Json) -> Self {
        let mut alternatives = Vec::new();
        expand(root, node, 0, &mut alternatives);
        Self { root, alternatives }
    }

    /// The node below `key`, or `None` if no such key may be given.
    pub(super) fn child(&self, key: &str) -> Option<SchemaNode<'a>> {
        let mut found = Vec::new();
        for node in &self.alternatives {
            if let Some(child) = node.get("properties").and_then(|p| p.get(key)) {
                expand(self.root, child, 0, &mut found);
            } else if let Some(child) = map_values(node) {
                expand(self.root, child, 0, &mut found);
            } else if node.as_bool() == Some(true) {
                found.push(node);
            }
        }
        (!found.is_empty()).then_some(Self { root: self.root, alternatives: found })
    }

    /// The node of an array's elements.
    pub(super) fn items(&self) -> Option<SchemaNode<'a>> {
        let items = |node: &&'a Json| node.get("items").filter(|i| i.is_object());
        let item = self.alternatives.iter().find_map(items)?;
        Some(Self::of(self.root, item))
    }

    fn has(&self, field: &str, wanted: &str) -> bool {
        self.alternatives.iter().any(|node| match node.get(field) {
            Some(Json::String(one)) => one == wanted,
            Some(Json::Array(many)) => many.iter().any(|one| one == wanted),
            _ => false,
        })
    }

    /// Whether the value is an `f32`.
    pub(super) fn is_f32(&self) -> bool {
        self.has("format", "float") && !self.has("format", "double")
    }

    /// Whether only text (or null) is accepted here.
    pub(super) fn is_text(&self) -> bool {
        let others = ["integer", "number", "boolean", "array", "object"];
        let enumerated = |node: &&&Json| node.get("enum").is_some() || node.get("const").is_some();
        (self.has("type", "string") || self.alternatives.iter().any(|n| enumerated(&n)))
            && !others.iter().any(|other| self.has("type", other))
    }

    /// All dotted keys below this node, sections included.
    pub(super) fn keys(&self, prefix: &str, depth: usize, out: &mut Vec<String>) {
        if depth > MAX_DEPTH {
            return;
        }
        for node in &self.alternatives {
            let Some(properties) = node.get("properties").and_then(Json::as_object) else {
                continue;
            };
            for (key, child) in properties {
                let path = super::text::join(prefix, key);
                Self::of(self.root, child).keys(&path, depth + 1, out);
                out.push(path);
            }
        }
    }
}

/// The schema of a map's values, where keys are free.
fn map_values(node: &Json) -> Option<&Json> {
    node.get("additionalProperties").filter(|values| values.as_bool() != Some(false))
}

fn expand<'a>(root: &'a Json, node: &'a Json, depth: usize, out: &mut Vec<&'a Json>) {
    if depth > MAX_DEPTH {
        return;
    }
    out.push(node);
    if let Some(reference) = node.get("$ref").and_then(Json::as_str)
        && let Some(target) = reference.strip_prefix('#').and_then(|p| root.pointer(p))
    {
        expand(root, target, depth + 1, out);
    }
    for group in ["anyOf", "oneOf", "allOf"] {
        for part in node.get(group).and_then(Json::as_array).into_iter().flatten() {
            expand(root, part, depth + 1, out);
        }
    }
}

/// Longest key, in bytes, for which the closest known key is sought; longer keys are not typing mistakes.
const MAX_KEY_LENGTH: usize = 100;

/// The key of `known` closest to `key`, if it is close enough to be a likely intention.
pub(super) fn closest(key: &str, known: &[String]) -> Option<String> {
    if key.len() > MAX_KEY_LENGTH {
        return None;
    }
    let last = |path: &str| path.rsplit('.').next().unwrap_or_default().to_owned();
    let score = |candidate: &String| {
        let whole = distance(key, candidate);
        // a correct name in the wrong section counts like a single typing mistake
        whole.min(1 + distance(&last(key), &last(candidate)))
    };
    let best = known.iter().min_by_key(|c| (score(c), distance(key, c)))?;
    let limit = (last(key).chars().count() / 3).max(2);
    (score(best) <= limit).then(|| best.clone())
}

/// Levenshtein distance in characters.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let replace = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = replace.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}
