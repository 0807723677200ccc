//! Parameters by name: one mechanism for checkpoints, optimiser groups and guards.
//!
//! A parameter's name is its path in the module, such as `gaussians.means` or `field.decoder.hidden_weight`.

use super::appearance::MATERIAL_NAME;
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData};
use std::collections::BTreeMap;

/// A tensor on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct HostTensor {
    /// Extents, slowest first.
    pub shape: Vec<usize>,
    /// Values, row-major.
    pub values: Vec<f32>,
}

/// Copies a tensor's values to the host, row-major.
pub fn to_vec<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    // every device computes in f32, so the memory is handed over without conversion
    match tensor.into_data().try_into_vec::<f32>() {
        Ok(values) => values,
        Err(error) => unreachable!("the backends of this crate compute in f32: {error:?}"),
    }
}

/// The path of module names that a visitor has entered.
#[derive(Default)]
pub struct ParameterPath(Vec<String>);

impl ParameterPath {
    /// Enters a module.
    pub fn enter(&mut self, name: &str) {
        self.0.push(name.to_owned());
    }
    /// Leaves a module.
    pub fn exit(&mut self) {
        self.0.pop();
    }
    /// The dotted name.
    pub fn name(&self) -> String {
        self.0.join(".")
    }
}

/// All float parameters of a module, by name.
pub fn collect<M: Module>(module: &M) -> BTreeMap<String, HostTensor> {
    struct Collector {
        path: ParameterPath,
        out: BTreeMap<String, HostTensor>,
    }
    impl ModuleVisitor for Collector {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.enter(name);
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.exit();
        }
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let tensor = HostTensor { shape: param.dims().to_vec(), values: to_vec(param.val()) };
            self.out.insert(self.path.name(), tensor);
        }
    }
    let mut collector = Collector { path: ParameterPath::default(), out: BTreeMap::new() };
    module.visit(&mut collector);
    collector.out
}

/// Number of values of each float parameter of a module, by name.
pub fn sizes<M: Module>(module: &M) -> BTreeMap<String, usize> {
    struct Sizes {
        path: ParameterPath,
        out: BTreeMap<String, usize>,
    }
    impl ModuleVisitor for Sizes {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.enter(name);
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.exit();
        }
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.out.insert(self.path.name(), param.dims().iter().product());
        }
    }
    let mut sizes = Sizes { path: ParameterPath::default(), out: BTreeMap::new() };
    module.visit(&mut sizes);
    sizes.out
}

/// Why named tensors do not fit a module.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// A parameter of the module is missing.
    #[error("tensor {0} is missing")]
    Missing(String),
    /// A shape differs.
    #[error("tensor {name} has shape {found:?}, the configuration requires {expected:?}")]
    Shape {
        /// The parameter.
        name: String,
        /// Shape found.
        found: Vec<usize>,
        /// Shape of the module's parameter.
        expected: Vec<usize>,
    },
}

/// Replaces every float parameter of `module` by the tensor of its name; the leading extent (the number of Gaussians)
/// may differ for names starting with `gaussians.`, except for the material, which is shared by all.
///
/// # Errors
/// A missing tensor or a shape that does not fit.
pub fn load<M: Module>(module: M, tensors: &BTreeMap<String, HostTensor>) -> Result<M, FitError> {
    struct Loader<'a> {
        path: ParameterPath,
        tensors: &'a BTreeMap<String, HostTensor>,
        error: Option<FitError>,
    }
    impl ModuleMapper for Loader<'_> {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.enter(name);
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.exit();
        }
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let name = self.path.name();
            let expected = param.dims().to_vec();
            let Some(tensor) = self.tensors.get(&name) else {
                self.error.get_or_insert(FitError::Missing(name));
                return param;
            };
            let free = usize::from(name.starts_with("gaussians.") && name != MATERIAL_NAME);
            let consistent = tensor.values.len() == tensor.shape.iter().product::<usize>();
            if tensor.shape.len() != D || tensor.shape[free..] != expected[free..] || !consistent {
                let found = tensor.shape.clone();
                self.error.get_or_insert(FitError::Shape { name, found, expected });
                return param;
            }
            let device = param.device();
            let data = TensorData::new(tensor.values.clone(), tensor.shape.clone());
            Param::from_tensor(Tensor::from_data(data, &device))
        }
    }
    let mut loader = Loader { path: ParameterPath::default(), tensors, error: None };
    let module = module.map(&mut loader);
    loader.error.map_or(Ok(module), Err)
}
