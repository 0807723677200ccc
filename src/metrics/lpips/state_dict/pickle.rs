//! The part of Python's pickle that `torch.save` writes for a state dict. Containers and files belong elsewhere.
//!
//! Values are nodes of one list and refer to each other by number, so that nothing is copied and nothing is walked
//! deeper than the tables ask for; a pickle makes at most one node an instruction.

use super::{Kind, Result, StateDictError, damaged, elements, unsupported};
use std::collections::{BTreeMap, HashMap};

/// The most sides a tensor may have.
const RANK: usize = 8;

/// Number of a node.
type Id = usize;

/// The functions and classes that a state dict names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Name {
    OrderedDict,
    RebuildTensor,
    RebuildParameter,
    Storage(Kind),
}

impl Name {
    fn of(module: &str, name: &str) -> Result<Self> {
        Ok(match (module, name) {
            ("collections", "OrderedDict") => Self::OrderedDict,
            ("torch._utils", "_rebuild_tensor" | "_rebuild_tensor_v2") => Self::RebuildTensor,
            ("torch._utils", "_rebuild_parameter") => Self::RebuildParameter,
            ("torch", "FloatStorage") => Self::Storage(Kind::Single),
            ("torch", "HalfStorage") => Self::Storage(Kind::Half),
            _ => return unsupported(format!("it names {module}.{name}, which is not called here")),
        })
    }
}

/// A storage as a pickle describes it: `count` values, of which tensors use a part.
#[derive(Clone, Copy, Debug)]
pub(super) struct Storage<'a> {
    pub key: &'a str,
    pub count: u64,
}

/// A tensor as a pickle describes it; `offset` and shape lie within the storage, in row-major order.
#[derive(Clone, Debug)]
pub(super) struct TorchTensor<'a> {
    pub kind: Kind,
    pub storage: Storage<'a>,
    /// Elements before the first.
    pub offset: u64,
    pub shape: Vec<usize>,
}

#[derive(Clone, Debug)]
enum Node<'a> {
    Nothing,
    Flag(bool),
    Int(i64),
    Text(&'a str),
    Name(Name),
    Items(Vec<Id>),
    Pairs(Vec<(Id, Id)>),
    /// `first` elements of the storage come before this view of it, which ends before element `end`.
    Storage {
        kind: Kind,
        storage: Storage<'a>,
        first: u64,
        end: u64,
    },
    Tensor(TorchTensor<'a>),
}

/// A pickle that has been read.
pub(super) struct Pickle<'a> {
    nodes: Vec<Node<'a>>,
    root: Id,
    /// Bytes up to its end.
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
            Node::Pairs(pairs) => pairs,
            _ => &[],
        }
    }

    /// The tensors of a dictionary; other entries are left out.
    pub(super) fn tensors(&self) -> BTreeMap<String, TorchTensor<'a>> {
        let tensor = |(key, value): &(Id, Id)| match (&self.nodes[*key], &self.nodes[*value]) {
            (Node::Text(key), Node::Tensor(tensor)) => Some(((*key).to_owned(), tensor.clone())),
            _ => None,
        };
        self.pairs().iter().filter_map(tensor).collect()
    }

    /// A flag in a dictionary.
    pub(super) fn flag(&self, key: &str) -> Option<bool> {
        self.pairs().iter().find_map(|(k, value)| match (&self.nodes[*k], &self.nodes[*value]) {
            (Node::Text(k), Node::Flag(flag)) if *k == key => Some(*flag),
            _ => None,
        })
    }

    /// The texts of a list of texts.
    pub(super) fn texts(&self) -> Option<Vec<&'a str>> {
        let Node::Items(items) = &self.nodes[self.root] else { return None };
        let text = |id: &Id| if let Node::Text(text) = &self.nodes[*id] { Some(*text) } else { None };
        items.iter().map(text).collect()
    }
}

/// The stack machine that a pickle is a program for.
struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    nodes: Vec<Node<'a>>,
    stack: Vec<Id>,
    /// Heights of the stack.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
    /// Pairs that calls have copied.
    copied: usize,
}

impl<'a> Machine<'a> {
    /// Does one instruction; false after the last.
    fn step(&mut self) -> Result<bool> {
        let [instruction] = self.array()?;
        match instruction {
            0x80 => {
                let [protocol] = self.array()?;
                if protocol > 5 {
                    return damaged(format!("protocol {protocol} of pickle"));
                }
            }
            b'.' => return Ok(false),
            b'(' => self.marks.push(self.stack.len()),
            b'N' => self.push(Node::Nothing),
            0x88 => self.push(Node::Flag(true)),
            0x89 => self.push(Node::Flag(false)),
            b'J' => {
                let value = i32::from_le_bytes(self.array()?);
                self.push(Node::Int(value.into()));
            }
            b'K' => {
                let [value] = self.array()?;
                self.push(Node::Int(value.into()));
            }
            b'M' => {
                let value = u16::from_le_bytes(self.array()?);
                self.push(Node::Int(value.into()));
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
                self.push(Node::Name(Name::of(module, name)?));
            }
            b')' | b']' => self.push(Node::Items(Vec::new())),
            b'}' => self.push(Node::Pairs(Vec::new())),
            b't' => {
                let items = self.above_mark()?;
                self.push(Node::Items(items));
            }
            0x85..=0x87 => {
                let count = usize::from(instruction - 0x84);
                let mut items = (0..count).map(|_| self.pop()).collect::<Result<Vec<_>>>()?;
                items.reverse();
                self.push(Node::Items(items));
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
                if !matches!(self.nodes[object], Node::Pairs(_)) {
                    return unsupported("it builds an object that is not a dictionary");
                }
            }
            other => return unsupported(format!("instruction 0x{other:02x} of pickle at byte {}", self.at - 1)),
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

    /// Up to the end of the line, which is left out.
    fn line(&mut self) -> Result<&'a str> {
        let length = self.bytes[self.at..].iter().position(|b| *b == b'\n').unwrap_or(usize::MAX - 1);
        let line = self.take(length.saturating_add(1))?;
        utf8(&line[..length])
    }

    fn text(&mut self, length: usize) -> Result<()> {
        let text = utf8(self.take(length)?)?;
        self.push(Node::Text(text));
        Ok(())
    }

    /// A whole number of up to eight bytes.
    fn long(&mut self, length: usize) -> Result<()> {
        let bytes = self.take(length)?;
        if length > 8 {
            return damaged(format!("a number of {length} bytes"));
        }
        let negative = bytes.last().is_some_and(|b| b & 0x80 != 0);
        let mut wide = [if negative { 0xff } else { 0 }; 8];
        wide[..length].copy_from_slice(bytes);
        self.push(Node::Int(i64::from_le_bytes(wide)));
        Ok(())
    }

    fn push(&mut self, node: Node<'a>) {
        self.stack.push(self.nodes.len());
        self.nodes.push(node);
    }

    fn top(&self) -> Result<Id> {
        let floor = self.marks.last().copied().unwrap_or(0);
        match self.stack.last() {
            Some(id) if self.stack.len() > floor => Ok(*id),
            _ => damaged("its description takes a value that is not there"),
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
            Node::Items(all) => all.extend(items),
            _ => return damaged("its description adds to something that is not a list"),
        }
        Ok(())
    }

    fn insert(&mut self, items: &[Id]) -> Result<()> {
        let dictionary = self.top()?;
        let (pairs, rest) = items.as_chunks::<2>();
        match &mut self.nodes[dictionary] {
            Node::Pairs(all) if rest.is_empty() => all.extend(pairs.iter().map(|[key, value]| (*key, *value))),
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

    fn items(&self, id: Id) -> &[Id] {
        match &self.nodes[id] {
            Node::Items(items) => items,
            _ => &[],
        }
    }

    fn count(&self, id: Id) -> Option<u64> {
        match &self.nodes[id] {
            Node::Int(value) => u64::try_from(*value).ok(),
            _ => None,
        }
    }

    /// `('storage', type, key, device, count[, (view, first, count)])`.
    fn storage(&self, id: Id) -> Result<Node<'a>> {
        let items = self.items(id);
        let found = match items {
            [tag, kind, key, _device, count, view @ ..] => self.storage_of([*tag, *kind, *key, *count], view.first()),
            _ => None,
        };
        found.map_or_else(|| damaged("the description of a storage"), Ok)
    }

    fn storage_of(&self, [tag, kind, key, count]: [Id; 4], view: Option<&Id>) -> Option<Node<'a>> {
        let (Node::Text("storage"), Node::Name(Name::Storage(kind)), Node::Text(key)) =
            (&self.nodes[tag], &self.nodes[kind], &self.nodes[key])
        else {
            return None;
        };
        // that its bytes can be counted
        let count = self.count(count).filter(|n| *n < 1 << 60)?;
        let (first, end) = match view.map(|v| &self.nodes[*v]) {
            None | Some(Node::Nothing) => (0, count),
            Some(Node::Items(view)) => {
                let [_, first, size] = view.as_slice() else { return None };
                let first = self.count(*first)?;
                (first, first.checked_add(self.count(*size)?).filter(|end| *end <= count)?)
            }
            Some(_) => return None,
        };
        Some(Node::Storage { kind: *kind, storage: Storage { key, count }, first, end })
    }

    fn call(&mut self, function: Id, arguments: Id) -> Result<()> {
        let Node::Name(name) = self.nodes[function] else { return damaged("it calls something that is no function") };
        let node = match name {
            Name::OrderedDict => self.ordered(arguments),
            Name::RebuildTensor => self.tensor(arguments).map(Node::Tensor),
            Name::RebuildParameter => {
                let Some(tensor) = self.items(arguments).first().copied() else {
                    return damaged("the description of a parameter");
                };
                self.stack.push(tensor);
                return Ok(());
            }
            Name::Storage(_) => return unsupported("it makes a storage of its own"),
        };
        self.push(node?);
        Ok(())
    }

    /// `OrderedDict()` or `OrderedDict([[key, value], ...])`.
    fn ordered(&mut self, arguments: Id) -> Result<Node<'a>> {
        let Some(list) = self.items(arguments).first().copied() else { return Ok(Node::Pairs(Vec::new())) };
        self.copied += self.items(list).len();
        if self.copied > self.bytes.len() {
            return damaged("its description copies the same dictionary again and again");
        }
        let pair = |id: &Id| match self.items(*id) {
            [key, value] => Ok((*key, *value)),
            _ => damaged("the description of a dictionary"),
        };
        Ok(Node::Pairs(self.items(list).iter().map(pair).collect::<Result<_>>()?))
    }

    /// `(storage, offset, shape, strides, ...)`.
    fn tensor(&self, arguments: Id) -> Result<TorchTensor<'a>> {
        let wrong = || StateDictError::Damaged("the description of a tensor".into());
        let [storage, offset, shape, strides, ..] = *self.items(arguments) else { return Err(wrong()) };
        let Node::Storage { kind, storage, first, end } = self.nodes[storage] else { return Err(wrong()) };
        if self.items(shape).len().max(self.items(strides).len()) > RANK {
            return unsupported(format!("a tensor of {} dimensions", self.items(shape).len()));
        }
        let sizes = |id| self.items(id).iter().map(|n| self.count(*n)).collect::<Option<Vec<u64>>>();
        let (shape, strides) = (sizes(shape).ok_or_else(wrong)?, sizes(strides).ok_or_else(wrong)?);
        let shape = shape.into_iter().map(usize::try_from).collect::<std::result::Result<Vec<_>, _>>();
        let shape = shape.map_err(|_| wrong())?;
        let count = elements(&shape).ok_or_else(wrong)?;
        let offset = self.count(offset).and_then(|n| n.checked_add(first)).ok_or_else(wrong)?;
        if shape.len() != strides.len() || offset.checked_add(count).is_none_or(|n| n > end) {
            return Err(wrong());
        }
        let mut expected = 1;
        for (side, stride) in shape.iter().zip(strides).rev() {
            if *side > 1 && stride != expected {
                return unsupported(format!("a tensor of shape {shape:?} is not stored in row-major order"));
            }
            expected *= (*side).max(1) as u64;
        }
        Ok(TorchTensor { kind, storage, offset, shape })
    }
}

fn utf8(bytes: &[u8]) -> Result<&str> {
    std::str::from_utf8(bytes).map_err(|_| StateDictError::Damaged("a name in it is no text".into()))
}
