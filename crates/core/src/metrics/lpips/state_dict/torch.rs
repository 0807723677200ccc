//! The PyTorch functions and classes named by state dicts, and what they create. Nothing else can be called.

use super::pickle::{Id, Machine, PickleValue};
use super::{Result, StateDictError, StorageKind, damaged, elements, unsupported};

/// Maximum number of dimensions of a tensor.
const RANK: usize = 8;

/// The functions and classes named by state dicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TorchName {
    OrderedDict,
    RebuildTensor,
    RebuildParameter,
    Storage(StorageKind),
}

impl TorchName {
    pub(super) fn of(module: &str, name: &str) -> Result<Self> {
        Ok(match (module, name) {
            ("collections", "OrderedDict") => Self::OrderedDict,
            ("torch._utils", "_rebuild_tensor" | "_rebuild_tensor_v2") => Self::RebuildTensor,
            ("torch._utils", "_rebuild_parameter") => Self::RebuildParameter,
            ("torch", "FloatStorage") => Self::Storage(StorageKind::Single),
            ("torch", "HalfStorage") => Self::Storage(StorageKind::Half),
            _ => return unsupported(format!("it refers to {module}.{name}, which is not supported")),
        })
    }
}

/// A storage as described by a pickle: `count` values, of which tensors use a part.
#[derive(Clone, Copy, Debug)]
pub(super) struct Storage<'a> {
    pub key: &'a str,
    pub count: u64,
}

/// A tensor as described by a pickle; it lies within the storage, in row-major order.
#[derive(Clone, Debug)]
pub(super) struct TorchTensor<'a> {
    pub kind: StorageKind,
    pub storage: Storage<'a>,
    /// Number of elements before its first.
    pub offset: u64,
    pub shape: Vec<usize>,
}

impl<'a> Machine<'a> {
    /// Parses `('storage', type, key, device, count[, (view, first, count)])`.
    pub(super) fn storage(&self, id: Id) -> Result<PickleValue<'a>> {
        let items = self.items(id);
        let found = match items {
            [tag, kind, key, _device, count, view @ ..] => self.storage_of([*tag, *kind, *key, *count], view.first()),
            _ => None,
        };
        found.ok_or_else(|| StateDictError::Damaged("the description of a storage is invalid".into()))
    }

    fn storage_of(&self, [tag, kind, key, count]: [Id; 4], view: Option<&Id>) -> Option<PickleValue<'a>> {
        let (PickleValue::Text("storage"), PickleValue::Name(TorchName::Storage(kind)), PickleValue::Text(key)) =
            (&self.nodes[tag], &self.nodes[kind], &self.nodes[key])
        else {
            return None;
        };
        // so that its bytes can be counted
        let count = self.count(count).filter(|n| *n < 1 << 60)?;
        let (first, end) = match view.map(|v| &self.nodes[*v]) {
            None | Some(PickleValue::Nothing) => (0, count),
            Some(PickleValue::Items(view)) => {
                let [_, first, size] = view.as_slice() else { return None };
                let first = self.count(*first)?;
                (first, first.checked_add(self.count(*size)?).filter(|end| *end <= count)?)
            }
            Some(_) => return None,
        };
        Some(PickleValue::Storage { kind: *kind, storage: Storage { key, count }, first, end })
    }

    pub(super) fn call(&mut self, function: Id, arguments: Id) -> Result<()> {
        let PickleValue::Name(name) = self.nodes[function] else {
            return damaged("it calls a value that is not a function");
        };
        let node = match name {
            TorchName::OrderedDict => self.ordered(arguments),
            TorchName::RebuildTensor => self.tensor(arguments).map(PickleValue::Tensor),
            TorchName::RebuildParameter => {
                let Some(tensor) = self.items(arguments).first().copied() else {
                    return damaged("the description of a parameter is invalid");
                };
                self.stack.push(tensor);
                return Ok(());
            }
            TorchName::Storage(_) => return unsupported("it creates a storage of its own"),
        };
        self.push(node?);
        Ok(())
    }

    /// Evaluates `OrderedDict()` or `OrderedDict([[key, value], ...])`.
    fn ordered(&mut self, arguments: Id) -> Result<PickleValue<'a>> {
        let Some(list) = self.items(arguments).first().copied() else { return Ok(PickleValue::Pairs(Vec::new())) };
        self.copied += self.items(list).len();
        if self.copied > self.bytes.len() {
            return damaged("its description copies the same dictionary again and again");
        }
        let pair = |id: &Id| match self.items(*id) {
            [key, value] => Ok((*key, *value)),
            _ => damaged("the description of a dictionary is invalid"),
        };
        Ok(PickleValue::Pairs(self.items(list).iter().map(pair).collect::<Result<_>>()?))
    }

    /// Parses `(storage, offset, shape, strides, ...)`.
    fn tensor(&self, arguments: Id) -> Result<TorchTensor<'a>> {
        let wrong = || StateDictError::Damaged("the description of a tensor is invalid".into());
        let [storage, offset, shape, strides, ..] = *self.items(arguments) else { return Err(wrong()) };
        let PickleValue::Storage { kind, storage, first, end } = self.nodes[storage] else { return Err(wrong()) };
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
        let mut expected = 1u64;
        for (side, stride) in shape.iter().zip(strides).rev() {
            if *side > 1 && stride != expected {
                return unsupported(format!("a tensor of shape {shape:?} is not stored in row-major order"));
            }
            // may be too large if another side is 0
            expected = expected.saturating_mul((*side).max(1) as u64);
        }
        Ok(TorchTensor { kind, storage, offset, shape })
    }
}
