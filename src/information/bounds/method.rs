//! The methods of bounds, with their names for people and in files.

use std::fmt;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::information::decoder::kind::DecoderKind;
use crate::information::estimator::Estimator;

/// The method that a lower or upper bound comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoundMethod {
    /// Upper bound of the causal density model in a bracket.
    Density,
    /// Upper bound of the Gaussian of the same mean and covariance.
    Gaussian,
    /// Upper bound by the entropy of the objects.
    EntropyBound,
    /// Lower or upper bound by annealed importance sampling.
    Ais,
    /// Lower bound of a decoder of either kind.
    Decoder,
    /// Lower bound of a fitted decoder that takes the beads of a patch as independent.
    FactorisedDecoder,
    /// Lower bound of a fitted decoder that conditions each bead on earlier ones.
    AutoregressiveDecoder,
    /// Lower bound of the decoder that comes with the program, without a fit.
    PretrainedDecoder,
    /// Upper bound of an estimator on its own.
    Estimator(Estimator),
    /// Bound of an optimization on the mask of one of its steps.
    Run {
        /// The step.
        step: usize,
    },
}

/// Methods that are no estimators, with their names in files.
const NAMES: [(BoundMethod, &str); 8] = [
    (BoundMethod::Density, "density"),
    (BoundMethod::Gaussian, "gaussian"),
    (BoundMethod::EntropyBound, "ceiling"),
    (BoundMethod::Ais, "posterior sampling"),
    (BoundMethod::Decoder, "decoder"),
    (BoundMethod::FactorisedDecoder, "factorised decoder"),
    (BoundMethod::AutoregressiveDecoder, "autoregressive decoder"),
    (BoundMethod::PretrainedDecoder, "decoder that comes with the program"),
];

/// Beginning of the name of a bound of an optimization; its step follows.
const RUN: &str = "run, step ";

impl BoundMethod {
    /// Whether the bound is that of a decoder.
    pub fn is_decoder(self) -> bool {
        matches!(self, Self::Decoder | Self::FactorisedDecoder | Self::AutoregressiveDecoder | Self::PretrainedDecoder)
    }

    /// Name in a sentence, with its article.
    pub fn in_sentence(self) -> String {
        if self == Self::Ais { self.to_string() } else { format!("the {self}") }
    }

    /// Name in JSON and CSV files.
    pub fn name_in_files(self) -> String {
        match self {
            Self::Estimator(estimator) => estimator.to_string(),
            Self::Run { step } => format!("{RUN}{step}"),
            method => NAMES.iter().find(|(of, _)| *of == method).map_or("", |(_, name)| name).to_owned(),
        }
    }
}

impl From<DecoderKind> for BoundMethod {
    fn from(kind: DecoderKind) -> Self {
        match kind {
            DecoderKind::Factorised => Self::FactorisedDecoder,
            DecoderKind::Autoregressive => Self::AutoregressiveDecoder,
        }
    }
}

impl fmt::Display for BoundMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Density => "density model",
            Self::Gaussian => "Gaussian bound",
            Self::EntropyBound => "entropy bound",
            Self::Ais => "AIS",
            Self::Decoder => "decoder",
            Self::FactorisedDecoder => "factorised decoder",
            Self::AutoregressiveDecoder => "autoregressive decoder",
            Self::PretrainedDecoder => "pretrained decoder",
            Self::Estimator(estimator) => return write!(f, "{estimator} estimate"),
            Self::Run { step } => return write!(f, "{RUN}{step}"),
        })
    }
}

impl Serialize for BoundMethod {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.name_in_files())
    }
}

impl<'de> Deserialize<'de> for BoundMethod {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        if let Some((method, _)) = NAMES.iter().find(|(_, known)| *known == name) {
            return Ok(*method);
        }
        if let Some(step) = name.strip_prefix(RUN).and_then(|step| step.parse().ok()) {
            return Ok(Self::Run { step });
        }
        let estimator = Estimator::deserialize(serde::de::value::StrDeserializer::<D::Error>::new(&name));
        estimator.map(Self::Estimator).map_err(|_| D::Error::custom(format!("no method of a bound is called {name:?}")))
    }
}

/// Any of the names in files.
#[cfg(test)]
impl schemars::JsonSchema for BoundMethod {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "BoundMethod".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let names: Vec<&str> = NAMES.iter().map(|(_, name)| *name).collect();
        schemars::json_schema!({
            "description": "The method that a bound comes from.",
            "anyOf": [
                {"enum": names},
                generator.subschema_for::<Estimator>(),
                {"type": "string", "pattern": format!("^{RUN}[0-9]+$")},
            ],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_files_are_read_again() {
        let estimators = [Estimator::GaussianStationary, Estimator::PixelCnn, Estimator::Causal];
        let all = NAMES.iter().map(|(method, _)| *method).chain(estimators.map(BoundMethod::Estimator));
        let all = all.chain([BoundMethod::Run { step: 12 }]);
        for method in all {
            let text = serde_json::to_string(&method).unwrap();
            assert_eq!(text, format!("\"{}\"", method.name_in_files()));
            assert_eq!(serde_json::from_str::<BoundMethod>(&text).unwrap(), method);
        }
        // An earlier name of an estimator.
        let full: BoundMethod = serde_json::from_str("\"full\"").unwrap();
        assert_eq!(full, BoundMethod::Estimator(Estimator::Causal));
        assert!(serde_json::from_str::<BoundMethod>("\"guess\"").is_err());
    }
}
