//! Reading and writing `edits.json`. The file is traversed by hand down to each edit, so that an error names the field;
//! the edits themselves are plain serde.

use super::error::EditError;
use super::operation::{Edit, Operation};
use super::stack::EditStack;
use crate::files::{read_regular, write_atomic};
use crate::versioned;
use serde_json::{Map, Value};
use std::path::Path;

impl EditStack {
    /// Reads a stack.
    ///
    /// # Errors
    /// [`EditError::Io`], [`EditError::Json`], [`EditError::Format`], or [`EditError::Field`] for a missing,
    /// unknown or wrong field, with its path.
    pub fn load(path: &Path) -> Result<Self, EditError> {
        let io = |source| EditError::Io { path: path.to_owned(), action: "read the edits", source };
        let bytes = read_regular(path).map_err(io)?;
        let value: Value =
            serde_json::from_slice(&bytes).map_err(|source| EditError::Json { path: path.to_owned(), source })?;
        EditReader { path }.stack(&value)
    }

    /// Writes the stack, replacing the file in one step.
    ///
    /// # Errors
    /// [`EditError::Io`].
    pub fn save(&self, path: &Path) -> Result<(), EditError> {
        let io = |source| EditError::Io { path: path.to_owned(), action: "write the edits", source };
        let mut text = versioned::to_json_pretty(self).map_err(|e| io(e.into()))?;
        text.push(b'\n');
        write_atomic(path, &text).map_err(io)
    }
}

struct EditReader<'a> {
    path: &'a Path,
}

impl EditReader<'_> {
    fn bad(&self, field: impl Into<String>, problem: impl Into<String>) -> EditError {
        EditError::Field { path: self.path.to_owned(), field: field.into(), problem: problem.into() }
    }

    fn stack(&self, value: &Value) -> Result<EditStack, EditError> {
        let map = self.object("the file", value)?;
        // before anything else, as a file of another version may hold fields unknown here
        versioned::check(map.get(versioned::KEY))
            .map_err(|source| EditError::Format { path: self.path.to_owned(), source })?;
        self.allow_only("", map, &[versioned::KEY, "operations", "undone"])?;
        Ok(EditStack { operations: self.edits(map, "operations")?, undone: self.edits(map, "undone")? })
    }

    fn edits(&self, map: &Map<String, Value>, field: &str) -> Result<Vec<Edit>, EditError> {
        let list =
            self.required("", map, field)?.as_array().ok_or_else(|| self.bad(field, "is not a list of edits"))?;
        list.iter().enumerate().map(|(i, value)| self.edit(&format!("{field}[{i}]"), value)).collect()
    }

    fn edit(&self, at: &str, value: &Value) -> Result<Edit, EditError> {
        let map = self.object(at, value)?;
        self.allow_only(at, map, &["segments", "operation"])?;
        let segments = serde_json::from_value(self.required(at, map, "segments")?.clone())
            .map_err(|_| self.bad(format!("{at}.segments"), "is not a list of segment names"))?;
        let value = self.required(at, map, "operation")?;
        let operation = serde_json::from_value::<Operation>(value.clone())
            .map_err(|error| self.operation_error(&format!("{at}.operation"), value, &error))?;
        let edit = Edit { segments, operation };
        edit.validate().map_err(|error| match error {
            EditError::Value { field, problem } => self.bad(format!("{at}.{field}"), problem),
            other => other,
        })?;
        Ok(edit)
    }

    /// Finds the field of an operation that serde could not read: each field name has one type in all operations.
    fn operation_error(&self, at: &str, value: &Value, error: &serde_json::Error) -> EditError {
        let only = value.as_object().filter(|map| map.len() == 1).and_then(|map| map.iter().next());
        let Some((name, Value::Object(fields))) = only else {
            return self.bad(at, format!("{error}; write it as in {{\"opacity\": {{\"factor\": 0.5}}}}"));
        };
        for (field, value) in fields {
            let wanted = match field.as_str() {
                "rgb" | "by" | "axis" if !is_point(value) => "three numbers",
                "about" if !value.is_null() && !is_point(value) => "three numbers or null",
                "factor" | "degrees" if !value.is_number() => "a number",
                "keep_shading" if !value.is_boolean() => "true or false",
                _ => continue,
            };
            return self.bad(format!("{at}.{name}.{field}"), format!("{value} is not {wanted}"));
        }
        self.bad(format!("{at}.{name}"), error.to_string())
    }

    fn object<'v>(&self, at: &str, value: &'v Value) -> Result<&'v Map<String, Value>, EditError> {
        value.as_object().ok_or_else(|| self.bad(at, "is not an object"))
    }

    fn required<'v>(&self, at: &str, map: &'v Map<String, Value>, field: &str) -> Result<&'v Value, EditError> {
        map.get(field).ok_or_else(|| self.bad(join(at, field), "is missing"))
    }

    fn allow_only(&self, at: &str, map: &Map<String, Value>, known: &[&str]) -> Result<(), EditError> {
        match map.keys().find(|key| !known.contains(&key.as_str())) {
            None => Ok(()),
            Some(key) => Err(self.bad(join(at, key), format!("is unknown; the fields are {}", known.join(", ")))),
        }
    }
}

fn join(at: &str, field: &str) -> String {
    if at.is_empty() { field.to_owned() } else { format!("{at}.{field}") }
}

fn is_point(value: &Value) -> bool {
    value.as_array().is_some_and(|list| list.len() == 3 && list.iter().all(Value::is_number))
}
