//! The state of a fit in a file, so that an estimate goes on where it was stopped.

use std::fmt::Debug;
use std::path::{Path, PathBuf};

use super::progress::Watch;
use crate::formats::{read_if_there, write_safely};
use crate::information::{CausalRequest, FitKeeper, InformationError, NUMBERS_VERSION, Trial, causal_estimate};

/// The estimate of a causal model, with the state of its fit in the file `keep` where one is named; the file stays until
/// [`forget_kept`]. `what` describes the fit completely.
///
/// # Errors
/// As [`causal_estimate`].
pub(super) fn kept_estimate<W: Debug>(
    request: &CausalRequest<'_>,
    keep: Option<&PathBuf>,
    what: impl FnOnce() -> W,
    watch: Watch<'_>,
) -> Result<Trial, InformationError> {
    let kept = keep.map(|path| KeptFit::new(path, &what()));
    let request = CausalRequest { keeper: kept.as_ref().map(|kept| kept as _), ..*request };
    let (trial, _) = causal_estimate(&request, &mut |fit| watch(&fit.into()))?;
    Ok(trial)
}

/// Removes the file of a fit, once all that follows the fit has come to its end too.
pub(super) fn forget_kept(keep: Option<&Path>) {
    if let Some(path) = keep {
        // A file that stays behind is replaced by the next fit, or refused as that of another one.
        let _ = std::fs::remove_file(path);
    }
}

/// A file that holds the state of one fit while it goes on.
struct KeptFit {
    path: PathBuf,
    key: String,
}

impl KeptFit {
    /// The file at `path`, for the fit that `what` describes completely.
    fn new(path: &Path, what: &dyn Debug) -> Self {
        // The alternate form writes out arrays of any length.
        let key = blake3::hash(format!("{NUMBERS_VERSION} {what:#?}").as_bytes()).to_hex().to_string();
        Self { path: path.to_owned(), key }
    }

    fn failed(&self, error: &dyn std::fmt::Display) -> InformationError {
        InformationError::WeightsFile { path: self.place(), reason: error.to_string() }
    }
}

impl FitKeeper for KeptFit {
    fn key(&self) -> &str {
        &self.key
    }

    fn place(&self) -> String {
        self.path.display().to_string()
    }

    fn load(&self) -> Result<Option<Vec<u8>>, InformationError> {
        read_if_there(&self.path).map_err(|error| self.failed(&error))
    }

    fn store(&self, state: &[u8]) -> Result<(), InformationError> {
        write_safely(&self.path, |out| out.write_all(state)).map_err(|error| self.failed(&error))
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::KeptFit;

    #[test]
    fn what_differs_in_the_middle_of_a_picture_is_another_fit() {
        let mut picture = Array2::<f32>::zeros((64, 64));
        let key = |picture: &Array2<f32>| KeptFit::new("fit".as_ref(), picture).key;
        let dark = key(&picture);
        picture[[32, 32]] = 1.0;
        assert_ne!(dark, key(&picture));
    }
}
