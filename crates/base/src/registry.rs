//! Process-wide tables of what configurations choose by name: built-in entries, and those that a program adds by
//! `volseggs::extend`. Both are found in the same way, and an added one replaces a built-in one of its name.

use std::collections::BTreeMap;
use std::sync::{PoisonError, RwLock};

/// A name that no entry of a table has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no {what} \"{name}\"; {}", available(.known))]
pub struct NotRegistered {
    /// What was looked up, such as `loss term`.
    pub what: &'static str,
    /// The name.
    pub name: String,
    /// The names that there are: built-in ones in the table's order, then the others, sorted.
    pub known: Vec<String>,
}

fn available(known: &[String]) -> String {
    if known.is_empty() {
        "none is registered: do so before `volseggs::main()`, see docs/research.md".to_owned()
    } else {
        format!("available: {}", known.join(", "))
    }
}

/// Built-in entries by name, one line each.
pub type EntryTable<T> = &'static [(&'static str, &'static T)];

/// A table of entries by name. Other threads see an entry as soon as it is inserted.
pub struct Registry<T: ?Sized + 'static> {
    what: &'static str,
    built_in: EntryTable<T>,
    added: RwLock<BTreeMap<String, &'static T>>,
}

impl<T: ?Sized + 'static> Registry<T> {
    /// Creates a table of `built_in` entries; `what` they are is for error messages.
    pub const fn new(what: &'static str, built_in: EntryTable<T>) -> Self {
        Self { what, built_in, added: RwLock::new(BTreeMap::new()) }
    }

    /// Inserts an entry, replacing any of the same name. It lives as long as the process, as do the built-in ones.
    pub fn insert(&self, name: &str, entry: Box<T>) {
        let entry: &'static T = Box::leak(entry);
        // nothing that runs under the lock could leave the map half-changed
        self.added.write().unwrap_or_else(PoisonError::into_inner).insert(plain(name), entry);
    }

    /// Finds the entry of that name.
    ///
    /// # Errors
    /// [`NotRegistered`], which lists the names that there are.
    pub fn get(&self, name: &str) -> Result<&'static T, NotRegistered> {
        let wanted = plain(name);
        let added = self.added.read().unwrap_or_else(PoisonError::into_inner).get(&wanted).copied();
        let built_in = || self.built_in.iter().find(|(known, _)| *known == wanted).map(|(_, entry)| *entry);
        added.or_else(built_in).ok_or_else(|| NotRegistered {
            what: self.what,
            name: name.to_owned(),
            known: self.names(),
        })
    }

    /// All entries: the built-in ones in their order, then the others, sorted by name.
    pub fn all(&self) -> Vec<(String, &'static T)> {
        let mut added = self.added.read().unwrap_or_else(PoisonError::into_inner).clone();
        let built_in = self.built_in.iter().map(|(name, entry)| {
            let entry = added.remove(*name).unwrap_or(*entry);
            ((*name).to_owned(), entry)
        });
        let mut all: Vec<_> = built_in.collect();
        all.extend(added);
        all
    }

    /// The names of all entries, in the same order.
    pub fn names(&self) -> Vec<String> {
        self.all().into_iter().map(|(name, _)| name).collect()
    }

    /// The names of the built-in entries, in the table's order, whether a program has replaced them or not.
    pub fn built_in_names(&self) -> impl Iterator<Item = &'static str> {
        self.built_in.iter().map(|(name, _)| *name)
    }

    /// Whether the entry of that name is a built-in one that no program has replaced.
    pub fn is_built_in(&self, name: &str) -> bool {
        let is_added = self.added.read().unwrap_or_else(PoisonError::into_inner).contains_key(name);
        !is_added && self.built_in.iter().any(|(known, _)| *known == name)
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
        let registry: Registry<str> = Registry::new("thing", &[]);
        let none = registry.get("a").err().unwrap().to_string();
        assert!(none.contains("no thing \"a\"") && none.contains("none is registered"), "{none}");
        registry.insert("b", "old".into());
        registry.insert("a", "other".into());
        registry.insert("b", "new".into());
        assert_eq!(registry.get("b").unwrap(), "new");
        assert_eq!(registry.names(), ["a", "b"]);
        let unknown = registry.get("c").err().unwrap();
        assert_eq!(unknown.to_string(), "there is no thing \"c\"; available: a, b");
        assert_eq!(unknown.known, ["a", "b"]);
    }

    #[test]
    fn built_in_entries_come_first_in_their_order_and_can_be_replaced() {
        let registry: Registry<str> = Registry::new("thing", &[("z", "last letter"), ("b", "built in")]);
        registry.insert("a", "added".into());
        assert_eq!((registry.get("z").unwrap(), registry.get("a").unwrap()), ("last letter", "added"));
        assert!(registry.is_built_in("b") && !registry.is_built_in("a") && !registry.is_built_in("c"));
        registry.insert("b", "replaced".into());
        let all = registry.all();
        assert_eq!(
            all.iter().map(|(name, entry)| (name.as_str(), *entry)).collect::<Vec<_>>(),
            [("z", "last letter"), ("b", "replaced"), ("a", "added")]
        );
        assert!(!registry.is_built_in("b"));
        assert_eq!(registry.built_in_names().collect::<Vec<_>>(), ["z", "b"]);
    }

    #[test]
    fn odd_characters_of_a_name_become_underscores() {
        let registry: Registry<str> = Registry::new("thing", &[]);
        registry.insert("a,b.c\n\u{e9}", "x".into());
        assert_eq!(registry.all()[0].0, "a_b_c__");
        assert!(registry.get("a,b.c\n\u{e9}").is_ok() && registry.get("a_b_c__").is_ok());
        registry.insert("", "empty".into());
        assert_eq!(registry.get("").unwrap(), "empty");
    }

    #[test]
    fn a_panic_under_the_lock_does_not_poison_it() {
        static REGISTRY: Registry<str> = Registry::new("thing", &[]);
        REGISTRY.insert("a", "x".into());
        let poisoned = std::thread::spawn(|| {
            let _held = REGISTRY.added.write().unwrap();
            panic!("on purpose");
        });
        assert!(poisoned.join().is_err());
        assert_eq!(REGISTRY.get("a").unwrap(), "x");
    }
}
