//! The messages as TypeScript declarations, and the elements of the page by their ids: with them, `tsc` checks the
//! page's modules. The files are committed, as the page has no build step, and a test fails while one is outdated.

use super::{Answer, Request};
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value as Json};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// Set to anything, it makes the test write the files.
const WRITE: &str = "VOLSEGGS_VIEW_WRITE";
/// How an outdated file is regenerated.
const REMEDY: &str = "VOLSEGGS_VIEW_WRITE=1 cargo test -p volseggs --lib declarations";

type Object = Map<String, Json>;

/// Adds the declarations of `T`, and of all types in it, to `types`, by their names.
fn declare<T: JsonSchema>(settings: SchemaSettings, types: &mut BTreeMap<String, String>) {
    let mut root = settings.into_generator().into_root_schema_for::<T>().to_value();
    let root = root.as_object_mut().expect("a type with fields has an object as its schema");
    let mut all = match root.remove("$defs") {
        Some(Json::Object(defs)) => defs,
        _ => Object::new(),
    };
    all.insert(T::schema_name().into_owned(), Json::Object(root.clone()));
    for (name, schema) in all {
        let text = format!("{}export type {name} = {};\n", docs(&schema, ""), type_of(&schema, ""));
        let before = types.insert(name.clone(), text.clone());
        assert!(before.is_none_or(|before| before == text), "{name}: sent and received in two forms; name them apart");
    }
}

/// The comment of a type or field, without the reminder of where its variants are.
fn docs(schema: &Json, indent: &str) -> String {
    let Some(text) = schema["description"].as_str() else { return String::new() };
    format!("{indent}/** {} */\n", text.replace('\n', &format!("\n{indent} * ")))
}

/// The TypeScript type of a schema; its further lines start with `indent`.
fn type_of(schema: &Json, indent: &str) -> String {
    let Some(schema) = schema.as_object() else { return "unknown".into() };
    // all of these hold at once
    let mut parts = Vec::new();
    parts.extend(
        schema.get("$ref").and_then(Json::as_str).map(|path| path.rsplit('/').next().unwrap_or(path).to_owned()),
    );
    for several in ["oneOf", "anyOf"] {
        parts.extend(schema.get(several).and_then(Json::as_array).map(|all| union(all, indent)));
    }
    if let Some(value) = schema.get("const") {
        parts.push(value.to_string());
    } else if let Some(values) = schema.get("enum").and_then(Json::as_array) {
        parts.push(values.iter().map(Json::to_string).collect::<Vec<_>>().join(" | "));
    } else {
        match schema.get("type") {
            Some(Json::String(name)) => parts.extend(primitive(name, schema, indent)),
            Some(Json::Array(names)) => {
                let names = names.iter().filter_map(Json::as_str);
                parts.push(names.filter_map(|name| primitive(name, schema, indent)).collect::<Vec<_>>().join(" | "));
            }
            _ => {}
        }
    }
    match parts.len() {
        0 => "unknown".into(),
        1 => parts.remove(0),
        _ => parts.iter().map(|part| enclosed(part)).collect::<Vec<_>>().join(" & "),
    }
}

fn union(all: &[Json], indent: &str) -> String {
    let deeper = format!("{indent}  ");
    // variants with comments stand on lines of their own
    if all.iter().all(|one| one["description"].is_null()) {
        return all.iter().map(|one| type_of(one, indent)).collect::<Vec<_>>().join(" | ");
    }
    let line = |one: &Json| format!("\n{}{deeper}| {}", docs(one, &deeper), type_of(one, &deeper));
    all.iter().map(line).collect()
}

fn enclosed(part: &str) -> String {
    if part.contains(" | ") { format!("({part})") } else { part.to_owned() }
}

/// The type of this JSON name; `None` for an object whose fields are given elsewhere.
fn primitive(name: &str, schema: &Object, indent: &str) -> Option<String> {
    Some(match name {
        "integer" | "number" => "number".into(),
        "array" => array(schema, indent),
        "object" => {
            let fields = schema.get("properties").and_then(Json::as_object)?;
            object(fields, schema.get("required").and_then(Json::as_array), indent)
        }
        other => other.to_owned(),
    })
}

fn array(schema: &Object, indent: &str) -> String {
    if let Some(items) = schema.get("prefixItems").and_then(Json::as_array) {
        return format!("[{}]", items.iter().map(|item| type_of(item, indent)).collect::<Vec<_>>().join(", "));
    }
    let item = schema.get("items").map_or("unknown".into(), |item| type_of(item, indent));
    let [min, max] = ["minItems", "maxItems"].map(|key| schema.get(key).and_then(Json::as_u64));
    match min {
        Some(n) if min == max => format!("[{}]", vec![item; n as usize].join(", ")),
        _ => format!("{}[]", enclosed(&item)),
    }
}

fn object(fields: &Object, required: Option<&Vec<Json>>, indent: &str) -> String {
    let deeper = format!("{indent}  ");
    let mut out = "{\n".to_owned();
    for (name, field) in fields {
        let mark = if required.is_some_and(|all| all.iter().any(|r| r == name)) { "" } else { "?" };
        out += &docs(field, &deeper);
        writeln!(out, "{deeper}{name}{mark}: {};", type_of(field, &deeper)).expect("writing to a string");
    }
    format!("{out}{indent}}}")
}

/// The declarations of all messages.
fn protocol() -> String {
    let mut types = BTreeMap::new();
    declare::<Request>(SchemaSettings::draft2020_12().for_deserialize(), &mut types);
    declare::<Answer>(SchemaSettings::draft2020_12().for_serialize(), &mut types);
    let types: Vec<String> = types.into_values().collect();
    format!(
        "// Messages of the page and of the viewer. Generated from their types in Rust:\n// {REMEDY}\n\n{}",
        types.join("\n")
    )
}

/// The elements of the page with an id, as the interface `Elements`: their DOM types by their ids.
fn elements(html: &str) -> String {
    let mut lines = Vec::new();
    for tag in html.split('<').skip(1) {
        let tag = tag.split('>').next().unwrap_or(tag);
        let name = tag.split_whitespace().next().unwrap_or(tag);
        let Some((_, id)) = tag.split_once(" id=\"") else { continue };
        let id = id.split('"').next().unwrap_or(id);
        let map = if name == "svg" { "SVGElementTagNameMap" } else { "HTMLElementTagNameMap" };
        lines.push(format!("  \"{id}\": {map}[\"{name}\"];\n"));
    }
    lines.sort();
    let lines: String = lines.concat();
    format!(
        "// Elements of index.html by their ids. Generated from it:\n// {REMEDY}\n\nexport interface Elements {{\n{lines}}}\n"
    )
}

#[test]
fn the_declarations_are_up_to_date() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/view/page");
    let html = include_str!("../page/index.html");
    for (name, now) in [("protocol.d.ts", protocol()), ("elements.d.ts", elements(html))] {
        let path = folder.join(name);
        if std::env::var_os(WRITE).is_some() {
            std::fs::write(&path, &now).unwrap();
        }
        let committed = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(committed == now, "{} is outdated; run: {REMEDY}", path.display());
    }
}

#[test]
fn options_are_optional_where_they_are_read_and_null_where_they_are_written() {
    let text = protocol();
    for part in ["within?: string | null;", "note: string | null;", "eye: [number, number, number];"] {
        assert!(text.contains(part), "{part}");
    }
    assert!(elements("<p id=\"a\"><svg\n id=\"b\">").contains("  \"a\": HTMLElementTagNameMap[\"p\"];\n  \"b\": SVG"));
}
