//! Process-wide registries by name, filled by a program at its start.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

/// A name under which nothing is registered.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no {kind} \"{name}\" is registered; {}", registered(.known))]
pub struct NotRegistered {
    /// What was looked up, such as `loss term`.
    pub kind: &'static str,
    /// The name.
    pub name: String,
    /// The registered names, sorted.
    pub known: Vec<String>,
}

fn registered(known: &[String]) -> String {
    if known.is_empty() {
        "there are none yet: register it before `volseggs::main()`, see docs/research.md".to_owned()
    } else {
        format!("registered: {}", known.join(", "))
    }
}

/// Entries of one kind, by name. Other threads see an entry as soon as it is inserted.
pub struct Registry<T: ?Sized> {
    kind: &'static str,
    entries: RwLock<BTreeMap<String, Arc<T>>>,
}

impl<T: ?Sized> Registry<T> {
    /// An empty registry; `kind` names one of its entries in errors, such as `loss term`.
    #[must_use]
    pub const fn new(kind: &'static str) -> Self {
        Self { kind, entries: RwLock::new(BTreeMap::new()) }
    }

    /// Inserts an entry, replacing any of the same name.
    pub fn insert(&self, name: &str, entry: Arc<T>) {
        // nothing that runs under the lock could leave the map half-changed
        self.entries.write().unwrap_or_else(PoisonError::into_inner).insert(plain(name), entry);
    }

    /// Returns the entry of that name.
    ///
    /// # Errors
    /// If there is none; the error lists the names that are.
    pub fn get(&self, name: &str) -> Result<Arc<T>, NotRegistered> {
        let entries = self.entries.read().unwrap_or_else(PoisonError::into_inner);
        entries.get(&plain(name)).cloned().ok_or_else(|| NotRegistered {
            kind: self.kind,
            name: name.to_owned(),
            known: entries.keys().cloned().collect(),
        })
    }

    /// Returns all entries, sorted by name.
    #[must_use]
    pub fn all(&self) -> Vec<(String, Arc<T>)> {
        let entries = self.entries.read().unwrap_or_else(PoisonError::into_inner);
        entries.iter().map(|(name, entry)| (name.clone(), Arc::clone(entry))).collect()
    }
}

/// The name with all characters replaced that dotted keys, CSV headings or file names cannot hold.
fn plain(name: &str) -> String {
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    name.chars().map(|c| if fits(c) { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_registration_wins_and_an_unknown_name_lists_all() {
        let registry: Registry<str> = Registry::new("thing");
        let none = registry.get("a").err().unwrap().to_string();
        assert!(none.contains("no thing \"a\"") && none.contains("none yet"), "{none}");
        registry.insert("b", "old".into());
        registry.insert("a", "other".into());
        registry.insert("b", "new".into());
        assert_eq!(&*registry.get("b").unwrap(), "new");
        assert_eq!(registry.all().iter().map(|(n, _)| n.as_str()).collect::<Vec<_>>(), ["a", "b"]);
        let unknown = registry.get("c").err().unwrap();
        assert_eq!(unknown.to_string(), "no thing \"c\" is registered; registered: a, b");
        assert_eq!(unknown.known, ["a", "b"]);
    }

    #[test]
    fn odd_characters_of_a_name_become_underscores() {
        let registry: Registry<str> = Registry::new("thing");
        registry.insert("a,b.c\n\u{e9}", "x".into());
        assert_eq!(registry.all()[0].0, "a_b_c__");
        assert!(registry.get("a,b.c\n\u{e9}").is_ok() && registry.get("a_b_c__").is_ok());
        registry.insert("", "empty".into());
        assert_eq!(&*registry.get("").unwrap(), "empty");
    }

    #[test]
    fn a_panic_under_the_lock_does_not_poison_it() {
        static REGISTRY: Registry<str> = Registry::new("thing");
        REGISTRY.insert("a", "x".into());
        let poisoned = std::thread::spawn(|| {
            let _held = REGISTRY.entries.write().unwrap();
            panic!("on purpose");
        });
        assert!(poisoned.join().is_err());
        assert_eq!(&*REGISTRY.get("a").unwrap(), "x");
    }
}
