//! An encoder made from an [`EncoderDefinition`], such as those of other programs: holds its learnt values as burn
//! parameters.

use super::encoder::{Encoder, EncoderFactory};
use super::encoder_definition::{EncoderDefinition, EncoderParameter, Parameters};
use crate::config::types::ModelConfig;
use crate::rng::{Purpose, Rng};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use std::fmt;

/// Why an encoder cannot be made from its definition.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DefinitionError {
    /// It has no features.
    #[error("encoder \"{0}\" has 0 features: at least 1")]
    NoFeatures(String),
    /// A parameter is inconsistent or has the name of another.
    #[error("encoder \"{encoder}\", parameter \"{parameter}\": {reason}")]
    Parameter {
        /// The encoder.
        encoder: String,
        /// The parameter.
        parameter: String,
        /// What is wrong.
        reason: String,
    },
}

/// An encoder with its definition and its parameters.
#[derive(Module, Debug)]
pub struct DefinedEncoder {
    /// The parameters, each flat, in the definition's order.
    pub values: Vec<Param<Tensor<1>>>,
    #[module(skip)]
    fixed: Fixed,
}

/// The parts that are not learnt.
#[derive(Clone)]
struct Fixed {
    name: String,
    definition: &'static dyn EncoderDefinition,
    /// Name and shape of each parameter.
    layout: Vec<(String, Vec<usize>)>,
    features: usize,
}

impl fmt::Debug for Fixed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Fixed").field("name", &self.name).field("layout", &self.layout).finish_non_exhaustive()
    }
}

impl DefinedEncoder {
    /// The encoder `config.encoder` of that definition at its initial values.
    ///
    /// # Errors
    /// If the definition is inconsistent.
    pub fn new(
        definition: &'static dyn EncoderDefinition,
        config: &ModelConfig,
        seed: u64,
        device: &Device,
    ) -> Result<Self, DefinitionError> {
        let parameters = define(definition, config, seed)?;
        let features = definition.features(config);
        let layout = parameters.iter().map(|p| (p.name.clone(), p.shape.clone())).collect();
        let value = |p: EncoderParameter| {
            let len = p.start.len();
            Param::from_tensor(Tensor::from_data(TensorData::new(p.start, [len]), device))
        };
        let values = parameters.into_iter().map(value).collect();
        Ok(Self { values, fixed: Fixed { name: config.encoder.clone(), definition, layout, features } })
    }

    /// The parameters by name, in their shapes.
    pub fn parameters(&self) -> Parameters {
        let parts = self.fixed.layout.iter().zip(&self.values);
        Parameters::new(parts.map(|((name, shape), value)| (name.clone(), shape.clone(), value.val())))
    }

    /// Number of features.
    pub fn features(&self) -> usize {
        self.fixed.features
    }

    /// Features `[N, features]` of points `[N, 3]` in [-1, 1] at `time` in [0, 1].
    ///
    /// # Panics
    /// If the definition returns features of another shape than it declares.
    pub fn forward(&self, points: Tensor<2>, time: f32) -> Tensor<2> {
        let expected = [points.dims()[0], self.fixed.features];
        let features = self.fixed.definition.forward(&self.parameters(), points, time);
        assert_eq!(features.dims(), expected, "shape of the features of encoder \"{}\"", self.fixed.name);
        features
    }
}

/// The parameters of a definition, checked.
fn define(
    definition: &dyn EncoderDefinition,
    config: &ModelConfig,
    seed: u64,
) -> Result<Vec<EncoderParameter>, DefinitionError> {
    let encoder = &config.encoder;
    if definition.features(config) == 0 {
        return Err(DefinitionError::NoFeatures(encoder.clone()));
    }
    let mut rng = Rng::new(seed, 2, Purpose::EncoderInit);
    let parameters = definition.parameters(config, &mut rng);
    for (i, p) in parameters.iter().enumerate() {
        let wanted: usize = p.shape.iter().product();
        let reason = if wanted == 0 {
            format!("shape {:?} is empty", p.shape)
        } else if p.start.len() != wanted {
            format!("shape {:?} needs {wanted} values, but {} are given", p.shape, p.start.len())
        } else if !p.start.iter().all(|v| v.is_finite()) {
            "an initial value is not finite".to_owned()
        } else if parameters[..i].iter().any(|other| other.name == p.name) {
            "listed twice".to_owned()
        } else {
            continue;
        };
        return Err(DefinitionError::Parameter { encoder: encoder.clone(), parameter: p.name.clone(), reason });
    }
    Ok(parameters)
}

/// How much longer an encoder made of tensor operations takes than the factorised one: a guess.
const RELATIVE_TIME: f64 = 1.6;

/// Makes [`DefinedEncoder`]s of one definition.
pub struct DefinedEncoderFactory(pub &'static dyn EncoderDefinition);

impl EncoderFactory for DefinedEncoderFactory {
    fn check(&self, config: &ModelConfig) -> Result<(), String> {
        define(self.0, config, 0).map(|_| ()).map_err(|e| e.to_string())
    }

    /// # Panics
    /// If [`EncoderFactory::check`] rejects the configuration.
    fn create(&self, config: &ModelConfig, seed: u64, device: &Device) -> Encoder {
        match DefinedEncoder::new(self.0, config, seed, device) {
            Ok(encoder) => Encoder::Extra(encoder),
            Err(error) => panic!("{error}"),
        }
    }

    fn features(&self, config: &ModelConfig) -> u128 {
        self.0.features(config) as u128
    }

    /// Not known before they are made.
    fn parameters(&self, _: &ModelConfig) -> u128 {
        0
    }

    fn relative_time(&self) -> f64 {
        RELATIVE_TIME
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::preset;
    use crate::device::DeviceName;
    use crate::model::encoder::ENCODERS;
    use crate::model::encoder::find_encoder;
    use crate::model::params;
    use crate::model::size::check_model;

    /// `x W t`, with arbitrary parameters.
    struct Linear(Vec<EncoderParameter>, usize);

    impl EncoderDefinition for Linear {
        fn features(&self, _: &ModelConfig) -> usize {
            self.1
        }
        fn parameters(&self, _: &ModelConfig, _: &mut Rng) -> Vec<EncoderParameter> {
            self.0.clone()
        }
        fn forward(&self, parameters: &Parameters, points: Tensor<2>, time: f32) -> Tensor<2> {
            points.matmul(parameters.get::<2>("weight")).mul_scalar(time)
        }
    }

    fn insert(name: &str, encoder: Linear) {
        ENCODERS.insert(name, Box::new(DefinedEncoderFactory(Box::leak(Box::new(encoder)))));
    }

    fn config(name: &str) -> ModelConfig {
        ModelConfig { encoder: name.to_owned(), ..preset("best").unwrap().model }
    }

    #[test]
    fn features_come_from_parameters_in_their_shapes_and_gradients_go_back() {
        let weight = EncoderParameter::new("weight", [3, 2], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        insert("test-linear", Linear(vec![weight], 2));
        let device = DeviceName::all()[0].open().unwrap().autodiff();
        let Encoder::Extra(encoder) = find_encoder("test-linear").unwrap().create(&config("test-linear"), 0, &device)
        else {
            unreachable!("made from a definition")
        };
        assert_eq!(encoder.features(), 2);
        assert_eq!(params::collect(&encoder).keys().collect::<Vec<_>>(), ["values.0"]);
        let points = Tensor::<2>::from_data(TensorData::new(vec![1.0f32, 10.0, 100.0], [1, 3]), &device);
        let out = encoder.forward(points, 0.5);
        assert_eq!(params::to_vec(out.clone()), [265.5, 321.0]);
        let gradients = out.sum().backward();
        let gradient = params::to_vec(encoder.values[0].val().grad(&gradients).unwrap());
        assert_eq!(gradient, [0.5, 0.5, 5.0, 5.0, 50.0, 50.0]);
    }

    #[test]
    fn a_definition_that_contradicts_itself_is_refused_by_name() {
        let zeros = |name: &str, n: usize| EncoderParameter::new(name, [n], vec![0.0; n]);
        let cases = [
            ("test-short", vec![EncoderParameter::new("table", [2, 3], vec![0.0; 5])], 1, "5 are given"),
            ("test-empty", vec![zeros("table", 0)], 1, "is empty"),
            ("test-twice", vec![zeros("table", 1), zeros("table", 2)], 1, "listed twice"),
            ("test-nan", vec![EncoderParameter::from_fn("table", [4], || f32::NAN)], 1, "not finite"),
            ("test-none", vec![zeros("table", 1)], 0, "0 features"),
        ];
        for (name, parameters, features, words) in cases {
            insert(name, Linear(parameters, features));
            let error = check_model(&config(name)).unwrap_err();
            assert!(error.contains(name) && error.contains(words), "{error}");
        }
        let error = check_model(&config("test-absent")).unwrap_err();
        assert!(error.contains("test-absent") && error.contains("test-short"), "{error}");
    }

    #[test]
    #[should_panic(expected = "no parameter \"wieght\" of 2 dimensions; it lists weight [3, 2]")]
    fn a_parameter_that_is_not_listed_is_named() {
        let device = DeviceName::all()[0].open().unwrap();
        let parameters = Parameters::start(vec![EncoderParameter::from_fn("weight", [3, 2], || 0.0)], &device);
        let _ = parameters.get::<2>("wieght");
    }
}
