//! Rewrites parser messages (serde, TOML, JSON, numbers) in plain words, without names of Rust types.

/// Returns `message` with the parsers' wording about types, fields, variants and numbers replaced, also after a prefix
/// such as `line 3: `; other text is unchanged.
pub fn plain(message: &str) -> String {
    message.trim_end().lines().map(plain_line).collect::<Vec<_>>().join("\n")
}

/// Beginnings of messages of serde.
const BEGINNINGS: [&str; 7] = [
    "invalid type: ",
    "invalid value: ",
    "invalid length ",
    "unknown field `",
    "unknown variant `",
    "missing field `",
    "duplicate field `",
];

/// What may follow a message: a hint.
const ENDS: [&str; 2] = ["; ", ". "];

fn plain_line(line: &str) -> String {
    // serde_json appends the position
    let (text, place) = match line.rfind(" at line ") {
        Some(at) => line.split_at(at),
        None => (line, ""),
    };
    let start = BEGINNINGS.iter().filter_map(|beginning| text.find(beginning)).min();
    let (prefix, text) = text.split_at(start.unwrap_or(text.len()));
    let new = wrong_value(text).or_else(|| wrong_name(text)).unwrap_or_else(|| text.to_owned());
    format!("{}{new}{place}", wrong_number(prefix))
}

/// Rewrites what the standard library says about texts that are no numbers. The program reads no negative whole numbers.
fn wrong_number(text: &str) -> String {
    let whole = "expected a whole number, 0 or above";
    text.replace("invalid digit found in string", whole)
        .replace("cannot parse integer from empty string", whole)
        .replace("number too large to fit in target type", "the number is too large")
        .replace("invalid float literal", "expected a number")
        .replace("cannot parse float from empty string", "expected a number")
}

/// Rewrites `invalid type: string "many", expected u32` and similar messages.
fn wrong_value(text: &str) -> Option<String> {
    let text = ["invalid type: ", "invalid value: ", "invalid length "].iter().find_map(|p| text.strip_prefix(p))?;
    let (found, wanted) = text.rsplit_once(", expected ")?;
    let (wanted, rest) = wanted.split_at(ENDS.iter().filter_map(|end| wanted.find(end)).min().unwrap_or(wanted.len()));
    Some(format!("expected {}, not {}{rest}", expected(wanted), given(found)))
}

fn expected(wanted: &str) -> String {
    let whole = |max: u64| format!("a whole number from 0 to {max}");
    match wanted {
        "u8" => whole(u64::from(u8::MAX)),
        "u16" => whole(u64::from(u16::MAX)),
        "u32" => whole(u64::from(u32::MAX)),
        "u64" | "usize" | "u128" => "a whole number, 0 or above".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "isize" | "i128" | "integer" => "a whole number".to_owned(),
        "a nonzero usize" | "a nonzero u32" | "a nonzero u64" => "a whole number, 1 or above".to_owned(),
        "f32" | "f64" | "float" => "a number".to_owned(),
        "bool" | "a boolean" => "true or false".to_owned(),
        "a string" | "string" | "str" | "path string" => "text".to_owned(),
        "a sequence" | "sequence" => "a list".to_owned(),
        "a map" | "map" => "a section (a table of keys)".to_owned(),
        "string or table" | "variant identifier" | "field identifier" => "a name".to_owned(),
        "any valid TOML value" => format!("a number from {} to {}", i64::MIN, i64::MAX),
        other => structured(other).unwrap_or_else(|| other.to_owned()),
    }
}

/// Describes types that have a name or a length.
fn structured(wanted: &str) -> Option<String> {
    if wanted.starts_with("struct ") || wanted.starts_with("internally tagged enum ") {
        return Some("a section (a table of keys)".to_owned());
    }
    if wanted.starts_with("enum ") {
        return Some("one of its names, as text".to_owned());
    }
    let length = ["an array of length ", "an array of size ", "a tuple of size "];
    let count = length.iter().find_map(|p| wanted.strip_prefix(p))?;
    Some(format!("a list of {count} values"))
}

fn given(found: &str) -> String {
    // in backticks, which the type of a number too large for others may follow: integer `3` as i128
    let inner =
        |rest: &str| rest.trim().strip_prefix('`').and_then(|r| r.split_once('`')).map(|(inner, _)| inner.to_owned());
    let after = |kind: &str| found.strip_prefix(kind).map(|rest| inner(rest).unwrap_or_else(|| rest.trim().to_owned()));
    if let Some(number) = after("integer ").or_else(|| after("floating point ")) {
        return number;
    }
    if let Some(text) = after("string ") {
        return format!("the text {text}");
    }
    if let Some(flag) = after("boolean ") {
        return flag;
    }
    match found {
        "sequence" => "a list".to_owned(),
        "map" => "a section".to_owned(),
        "unit value" | "null" | "Option value" => "nothing".to_owned(),
        // from `invalid length`
        count if count.parse::<usize>().is_ok() => format!("{count} values"),
        other => other.to_owned(),
    }
}

/// Rewrites `unknown field`, `unknown variant`, `missing field` and `duplicate field`.
fn wrong_name(text: &str) -> Option<String> {
    let quoted = |prefix: &str| {
        let (name, rest) = text.strip_prefix(prefix)?.strip_prefix('`')?.split_once('`')?;
        Some((name, rest))
    };
    let known = |rest: &str| {
        let rest = rest.strip_prefix(", ").unwrap_or(rest);
        let list = rest.strip_prefix("expected one of ").or_else(|| rest.strip_prefix("expected "));
        list.map_or_else(String::new, |list| format!("; available: {}", list.replace('`', "")))
    };
    if let Some((name, rest)) = quoted("unknown field ") {
        return Some(format!("unknown key `{name}`{}", known(rest)));
    }
    if let Some((name, rest)) = quoted("unknown variant ") {
        return Some(format!("there is no `{name}`{}", known(rest)));
    }
    if let Some((name, rest)) = quoted("missing field ") {
        return Some(format!("`{name}` is missing{rest}"));
    }
    quoted("duplicate field ").map(|(name, rest)| format!("`{name}` is given twice{rest}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_rust_type_is_named() {
        for (was, is) in [
            (
                "invalid type: string \"many\", expected u32",
                "expected a whole number from 0 to 4294967295, not the text \"many\"",
            ),
            ("invalid value: integer `-4`, expected u64", "expected a whole number, 0 or above, not -4"),
            ("invalid type: floating point `0.5`, expected usize", "expected a whole number, 0 or above, not 0.5"),
            ("invalid type: integer `3`, expected struct ModelConfig", "expected a section (a table of keys), not 3"),
            (
                "invalid type: boolean `true`, expected f64 at line 3 column 7",
                "expected a number, not true at line 3 column 7",
            ),
            ("invalid length 3, expected an array of length 2", "expected a list of 2 values, not 3 values"),
            ("invalid type: sequence, expected a string", "expected text, not a list"),
            ("unknown variant `l3`, expected `l1` or `l2`", "there is no `l3`; available: l1 or l2"),
            ("unknown field `sedes`, expected one of `title`, `seeds`", "unknown key `sedes`; available: title, seeds"),
            ("missing field `name`", "`name` is missing"),
            ("duplicate field `a`", "`a` is given twice"),
            ("line 3\ninvalid type: map, expected a string\n", "line 3\nexpected text, not a section"),
            ("the file ends", "the file ends"),
            ("line 3: invalid type: sequence, expected u64", "line 3: expected a whole number, 0 or above, not a list"),
            (
                "invalid JSON in header: invalid type: integer `3`, expected struct HashMetadata at line 1 column 1",
                "invalid JSON in header: expected a section (a table of keys), not 3 at line 1 column 1",
            ),
            (
                "invalid type: integer `99999999999999999999` as i128, expected any valid TOML value",
                "expected a number from -9223372036854775808 to 9223372036854775807, not 99999999999999999999",
            ),
            (
                "error: invalid value 'nan' for '--fps <N>': invalid digit found in string",
                "error: invalid value 'nan' for '--fps <N>': expected a whole number, 0 or above",
            ),
            (
                "a.json: field `x`: invalid type: map, expected f64. Hint: write it again",
                "a.json: field `x`: expected a number, not a section. Hint: write it again",
            ),
            ("a: missing field `dims`; the fields are dims, type", "a: `dims` is missing; the fields are dims, type"),
            ("number too large to fit in target type", "the number is too large"),
        ] {
            assert_eq!(plain(was), is);
        }
    }
}
