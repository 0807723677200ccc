//! The instructions of Python's pickle that `torch.save` writes for a state dict. The functions they call are in
//! `torch`; containers and files are handled elsewhere.
//!
//! Values are nodes of one list and refer to each other by number, so nothing is copied and nothing is traversed deeper
//! than the tables require; a pickle makes at most one node per instruction.

use super::torch::{Storage, TorchName, TorchTensor};
use super::{Result, StateDictError, StorageKind, damaged, unsupported};
use std::collections::{BTreeMap, HashMap};

/// Index of a node.
pub(super) type Id = usize;

/// A value.
#[derive(Clone, Debug)]
pub(super) enum PickleValue<'a> {
    Nothing,
    Flag(bool),
    Int(i64),
    Text(&'a str),
    Name(TorchName),
    Items(Vec<Id>),
    Pairs(Vec<(Id, Id)>),
    /// A view of a storage, from element `first` up to, but not including, element `end`.
    Storage {
        kind: StorageKind,
        storage: Storage<'a>,
        first: u64,
        end: u64,
    },
    Tensor(TorchTensor<'a>),
}

/// A parsed pickle.
pub(super) struct Pickle<'a> {
    nodes: Vec<PickleValue<'a>>,
    root: Id,
    /// Its length in bytes.
    pub length: usize,
}

/// Reads the pickle at the start of `bytes`.
pub(super) fn read(bytes: &[u8]) -> Result<Pickle<'_>> {
    let (nodes, stack, marks) = (Vec::new(), Vec::new(), Vec::new());
    let mut machine = Machine { bytes, at: 0, nodes, stack, marks, memo: HashMap::new(), copied: 0 };
    while machine.step()? {}
    let root = machine.pop()?;
    Ok(Pickle { nodes: machine.nodes, root, length: machine.at })
}

impl<'a> Pickle<'a> {
    fn pairs(&self) -> &[(Id, Id)] {
        match &self.nodes[self.root] {
            PickleValue::Pairs(pairs) => pairs,
            _ => &[],
        }
    }

    /// The tensors of a dictionary; other entries are omitted.
    pub(super) fn tensors(&self) -> BTreeMap<String, TorchTensor<'a>> {
        let tensor = |(key, value): &(Id, Id)| match (&self.nodes[*key], &self.nodes[*value]) {
            (PickleValue::Text(key), PickleValue::Tensor(tensor)) => Some(((*key).to_owned(), tensor.clone())),
            _ => None,
        };
        self.pairs().iter().filter_map(tensor).collect()
    }

    /// A flag in a dictionary.
    pub(super) fn flag(&self, key: &str) -> Option<bool> {
        self.pairs().iter().find_map(|(k, value)| match (&self.nodes[*k], &self.nodes[*value]) {
            (PickleValue::Text(k), PickleValue::Flag(flag)) if *k == key => Some(*flag),
            _ => None,
        })
    }

    /// The strings of a list of strings.
    pub(super) fn texts(&self) -> Option<Vec<&'a str>> {
        let PickleValue::Items(items) = &self.nodes[self.root] else { return None };
        let text = |id: &Id| if let PickleValue::Text(text) = &self.nodes[*id] { Some(*text) } else { None };
        items.iter().map(text).collect()
    }
}

/// The stack machine that executes a pickle.
pub(super) struct Machine<'a> {
    pub bytes: &'a [u8],
    at: usize,
    pub nodes: Vec<PickleValue<'a>>,
    pub stack: Vec<Id>,
    /// Heights of the stack at the open marks.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
    /// Number of pairs copied by calls.
    pub copied: usize,
}

impl<'a> Machine<'a> {
    /// Executes one instruction; returns false after the last.
    fn step(&mut self) -> Result<bool> {
        let [instruction] = self.array()?;
        match instruction {
            0x80 => {
                let [protocol] = self.array()?;
                if protocol > 5 {
                    return damaged(format!("unknown pickle protocol {protocol}"));
                }
            }
            b'.' => return Ok(false),
            b'(' => self.marks.push(self.stack.len()),
            b'N' => self.push(PickleValue::Nothing),
            0x88 => self.push(PickleValue::Flag(true)),
            0x89 => self.push(PickleValue::Flag(false)),
            b'J' => {
                let value = i32::from_le_bytes(self.array()?);
                self.push(PickleValue::Int(value.into()));
            }
            b'K' => {
                let [value] = self.array()?;
                self.push(PickleValue::Int(value.into()));
            }
            b'M' => {
                let value = u16::from_le_bytes(self.array()?);
                self.push(PickleValue::Int(value.into()));
            }
            0x8a => {
                let [length] = self.array()?;
                self.long(length.into())?;
            }
            b'U' => {
                let [length] = self.array()?;
                self.text(length.into())?;
            }
            b'T' | b'X' => {
                let length = u32::from_le_bytes(self.array()?);
                self.text(length as usize)?;
            }
            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                self.push(PickleValue::Name(TorchName::of(module, name)?));
            }
            b')' | b']' => self.push(PickleValue::Items(Vec::new())),
            b'}' => self.push(PickleValue::Pairs(Vec::new())),
            b't' => {
                let items = self.above_mark()?;
                self.push(PickleValue::Items(items));
            }
            0x85..=0x87 => {
                let count = usize::from(instruction - 0x84);
                let mut items = (0..count).map(|_| self.pop()).collect::<Result<Vec<_>>>()?;
                items.reverse();
                self.push(PickleValue::Items(items));
            }
            b'a' => {
                let item = self.pop()?;
                self.append(vec![item])?;
            }
            b'e' => {
                let items = self.above_mark()?;
                self.append(items)?;
            }
            b's' => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.insert(&[key, value])?;
            }
            b'u' => {
                let items = self.above_mark()?;
                self.insert(&items)?;
            }
            b'q' => {
                let [index] = self.array()?;
                self.remember(index.into())?;
            }
            b'r' => {
                let index = u32::from_le_bytes(self.array()?);
                self.remember(index)?;
            }
            b'h' => {
                let [index] = self.array()?;
                self.recall(index.into())?;
            }
            b'j' => {
                let index = u32::from_le_bytes(self.array()?);
                self.recall(index)?;
            }
            b'Q' => {
                let id = self.pop()?;
                let storage = self.storage(id)?;
                self.push(storage);
            }
            b'R' => {
                let (arguments, function) = (self.pop()?, self.pop()?);
                self.call(function, arguments)?;
            }
            // attributes of a dictionary, such as the versions of layers
            b'b' => {
                self.pop()?;
                let object = self.top()?;
                if !matches!(self.nodes[object], PickleValue::Pairs(_)) {
                    return unsupported("it builds an object that is not a dictionary");
                }
            }
            other => return unsupported(format!("pickle instruction 0x{other:02x} at byte {}", self.at - 1)),
        }
        Ok(true)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.bytes.len());
        let Some(end) = end else { return damaged("it ends in the middle of its description") };
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    /// Reads up to the end of the line, which is dropped.
    fn line(&mut self) -> Result<&'a str> {
        let length = self.bytes[self.at..].iter().position(|b| *b == b'\n').unwrap_or(usize::MAX - 1);
        let line = self.take(length.saturating_add(1))?;
        utf8(&line[..length])
    }

    fn text(&mut self, length: usize) -> Result<()> {
        let text = utf8(self.take(length)?)?;
        self.push(PickleValue::Text(text));
        Ok(())
    }

    /// Reads an integer of up to eight bytes.
    fn long(&mut self, length: usize) -> Result<()> {
        let bytes = self.take(length)?;
        if length > 8 {
            return damaged(format!("an integer of {length} bytes"));
        }
        let negative = bytes.last().is_some_and(|b| b & 0x80 != 0);
        let mut wide = [if negative { 0xff } else { 0 }; 8];
        wide[..length].copy_from_slice(bytes);
        self.push(PickleValue::Int(i64::from_le_bytes(wide)));
        Ok(())
    }

    pub(super) fn push(&mut self, node: PickleValue<'a>) {
        self.stack.push(self.nodes.len());
        self.nodes.push(node);
    }

    fn top(&self) -> Result<Id> {
        let floor = self.marks.last().copied().unwrap_or(0);
        match self.stack.last() {
            Some(id) if self.stack.len() > floor => Ok(*id),
            _ => damaged("its description uses a missing value"),
        }
    }

    fn pop(&mut self) -> Result<Id> {
        let id = self.top()?;
        self.stack.pop();
        Ok(id)
    }

    fn above_mark(&mut self) -> Result<Vec<Id>> {
        match self.marks.pop() {
            Some(mark) => Ok(self.stack.split_off(mark)),
            None => damaged("its description ends a list that was not begun"),
        }
    }

    fn append(&mut self, items: Vec<Id>) -> Result<()> {
        let list = self.top()?;
        match &mut self.nodes[list] {
            PickleValue::Items(all) => all.extend(items),
            _ => return damaged("its description adds to something that is not a list"),
        }
        Ok(())
    }

    fn insert(&mut self, items: &[Id]) -> Result<()> {
        let dictionary = self.top()?;
        let (pairs, rest) = items.as_chunks::<2>();
        match &mut self.nodes[dictionary] {
            PickleValue::Pairs(all) if rest.is_empty() => all.extend(pairs.iter().map(|[key, value]| (*key, *value))),
            _ => return damaged("its description adds to something that is not a dictionary"),
        }
        Ok(())
    }

    fn remember(&mut self, index: u32) -> Result<()> {
        let id = self.top()?;
        self.memo.insert(index, id);
        Ok(())
    }

    fn recall(&mut self, index: u32) -> Result<()> {
        match self.memo.get(&index) {
            Some(id) => self.stack.push(*id),
            None => return damaged(format!("its description recalls value {index}, which it never stored")),
        }
        Ok(())
    }

    pub(super) fn items(&self, id: Id) -> &[Id] {
        match &self.nodes[id] {
            PickleValue::Items(items) => items,
            _ => &[],
        }
    }

    pub(super) fn count(&self, id: Id) -> Option<u64> {
        match &self.nodes[id] {
            PickleValue::Int(value) => u64::try_from(*value).ok(),
            _ => None,
        }
    }
}

fn utf8(bytes: &[u8]) -> Result<&str> {
    std::str::from_utf8(bytes).map_err(|_| StateDictError::Damaged("a name in it is not valid text".into()))
}
