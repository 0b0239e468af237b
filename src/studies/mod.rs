//! Studies: scenes on which the estimators themselves are put to the test.

mod error;
mod known_truths;

pub use error::StudyError;
pub use known_truths::{GaussianField, KnownTruth, OneBead, TrueInformation, TwoRates};
