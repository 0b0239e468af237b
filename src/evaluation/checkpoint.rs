//! Checkpoints of estimates: files from which an interrupted estimate resumes.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::formats::{DocumentKind, NameLock, content_key, lock_name, read_if_there, remove_if_there, write_safely};
use crate::information::{
    AisBound, Decoder, FitCheckpoint, FitFile, InformationError, LowerBound, NUMBERS_VERSION, Trial,
};

/// The completed parts of an estimate, in a file if one is named. The state of the running fit lies beside it. Without a file every part
/// is computed.
pub(crate) struct EstimateCheckpoint {
    path: Option<PathBuf>,
    /// Held while the estimate runs, so that no other one keeps its parts there.
    _lock: Option<NameLock>,
    since: Instant,
    parts: Parts,
    /// Whether later parts are stored. False once weights could not be written, because the same command is to try again.
    goes_on: bool,
}

/// The kind of the file.
const ESTIMATE_CHECKPOINT: DocumentKind =
    DocumentKind::unmarked_before("lenslet-studio/estimate-checkpoint", "the state of an estimate");

/// Identity of an estimate: all that decides its numbers, apart from the version of the program's numbers.
pub(crate) struct Identity {
    /// The entries by fixed names, which no change of the code renames.
    pub content: Value,
    /// The texts by which earlier versions of the program identified estimates. Older files know the estimate by one of them. An estimate
    /// of another version of the numbers is never resumed, so these texts can go with the next change of the numbers.
    pub earlier: Vec<String>,
}

/// Contents of the file.
#[derive(Default, Serialize, Deserialize)]
struct Parts {
    /// Identifies the estimate.
    key: String,
    /// The key of fits that an earlier program started beside it, if there are any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    earlier_key: Option<String>,
    trials: Vec<Trial>,
    /// The decoder's bound, and its weights as a safetensors file.
    decoder: Option<(LowerBound, Vec<u8>)>,
    below: Option<AisBound>,
    above: Option<AisBound>,
    /// Time for all parts before the running one, seconds.
    #[serde(default)]
    seconds: f64,
}

impl Parts {
    fn hold_nothing(&self) -> bool {
        let Self { key: _, earlier_key: _, trials, decoder, below, above, seconds: _ } = self;
        trials.is_empty() && decoder.is_none() && below.is_none() && above.is_none()
    }

    /// The time of the parts alone, seconds.
    fn own_seconds(&self) -> f64 {
        let trials = self.trials.iter().map(Trial::seconds);
        let bounds = [&self.below, &self.above].into_iter().flatten().map(|bound| bound.seconds);
        trials.chain(bounds).chain(self.decoder.iter().map(|(bound, _)| bound.seconds)).sum()
    }
}

impl EstimateCheckpoint {
    /// Opens the checkpoint at `path` of the estimate of this identity.
    ///
    /// # Errors
    /// Where the file cannot be read, holds another estimate, or is in use by a running one.
    pub fn open(path: Option<&Path>, identity: impl FnOnce() -> Identity) -> Result<Self, InformationError> {
        // A mask may be an image of millions of numbers. It is not serialized where nothing is kept.
        let Some(path) = path else {
            return Ok(Self { path: None, _lock: None, since: Instant::now(), parts: Parts::default(), goes_on: true });
        };
        let lock = lock_name(path, &fit_file(path, LOCK))?;
        let Identity { content, earlier } = identity();
        let key = content_key(&json!([NUMBERS_VERSION, content]));
        let refused = |reason: String| failed(path, &reason);
        let found = read_if_there(path)?;
        if found.is_none() {
            // States beside the file belong to an estimate that was given up.
            forget_fits(path)?;
        }
        let another = |found: String| {
            refused(format!("expected the state of an estimate, found another file ({found}); choose another name"))
        };
        let mut parts = match found {
            Some(bytes) => {
                let value: Value = serde_json::from_slice(&bytes).map_err(|error| another(error.to_string()))?;
                ESTIMATE_CHECKPOINT.version_of(&value).map_err(|found| another(found.to_string()))?;
                serde_json::from_value::<Parts>(value).map_err(|error| another(error.to_string()))?
            }
            None => Parts { key: key.clone(), ..Parts::default() },
        };
        if earlier.iter().any(|text| earlier_key(text) == parts.key) {
            parts.earlier_key = Some(std::mem::replace(&mut parts.key, key.clone()));
        }
        // A checkpoint without any completed part blocks nothing.
        let parts = match parts.key == key {
            true => parts,
            false if parts.hold_nothing() && fits(path).next().is_none() => Parts { key, ..Parts::default() },
            false => return Err(refused(InformationError::OtherFit.to_string())),
        };
        let mut kept = Self { path: Some(path.to_owned()), _lock: lock, since: Instant::now(), parts, goes_on: true };
        kept.store()?;
        Ok(kept)
    }

    /// Returns trial `index`, counted from 0 and requested in order: the stored one, or the one that `compute` returns. `compute`
    /// receives the keeper of its fit's state.
    ///
    /// # Errors
    /// As `compute`.
    pub fn trial<E: From<InformationError>>(
        &mut self,
        index: usize,
        compute: impl FnOnce(Option<&dyn FitCheckpoint>) -> Result<Trial, E>,
    ) -> Result<Trial, E> {
        if let Some(trial) = self.parts.trials.get(index) {
            return Ok(trial.clone());
        }
        let fit = self.fit(&trial_part(index));
        let trial = compute(keeper(fit.as_ref()))?;
        self.goes_on &= trial.unwritten_weights().is_none();
        self.parts.trials.push(trial.clone());
        self.keep(fit);
        Ok(trial)
    }

    /// Time for the estimate before and after its interruption, seconds. An incomplete part counts as far as the state of that part
    /// records it.
    pub fn seconds(&self) -> f64 {
        (self.parts.seconds + self.since.elapsed().as_secs_f64()).max(self.parts.own_seconds())
    }

    /// The smallest of the completed trials.
    pub fn smallest(&self) -> Option<f64> {
        self.parts.trials.iter().map(Trial::bits_per_pixel).min_by(f64::total_cmp)
    }

    /// Returns the decoder's bound and the decoder: the stored ones, or those that `compute` returns. `compute` receives the keeper of
    /// its fit's state.
    ///
    /// # Errors
    /// As [`EstimateCheckpoint::trial`].
    pub fn decoder(
        &mut self,
        compute: impl FnOnce(Option<&dyn FitCheckpoint>) -> Result<(LowerBound, Decoder), InformationError>,
    ) -> Result<(LowerBound, Decoder), InformationError> {
        if let Some((bound, bytes)) = &self.parts.decoder {
            return Ok((bound.clone(), Decoder::from_bytes(bytes)?));
        }
        let fit = self.fit(DECODER);
        let (bound, decoder) = compute(keeper(fit.as_ref()))?;
        if fit.is_some() {
            self.parts.decoder = Some((bound.clone(), decoder.to_bytes()?));
            self.keep(fit);
        }
        Ok((bound, decoder))
    }

    /// The lower bound by annealed importance sampling.
    ///
    /// # Errors
    /// As [`EstimateCheckpoint::trial`].
    pub fn below(
        &mut self,
        compute: impl FnOnce(Option<&dyn FitCheckpoint>) -> Result<AisBound, InformationError>,
    ) -> Result<AisBound, InformationError> {
        self.bound(BELOW, |parts| &mut parts.below, compute)
    }

    /// The upper bound by annealed importance sampling.
    ///
    /// # Errors
    /// As [`EstimateCheckpoint::trial`].
    pub fn above(
        &mut self,
        compute: impl FnOnce(Option<&dyn FitCheckpoint>) -> Result<AisBound, InformationError>,
    ) -> Result<AisBound, InformationError> {
        self.bound(ABOVE, |parts| &mut parts.above, compute)
    }

    fn bound(
        &mut self,
        part: &str,
        place: fn(&mut Parts) -> &mut Option<AisBound>,
        compute: impl FnOnce(Option<&dyn FitCheckpoint>) -> Result<AisBound, InformationError>,
    ) -> Result<AisBound, InformationError> {
        if let Some(bound) = place(&mut self.parts) {
            return Ok(bound.clone());
        }
        let fit = self.fit(part);
        let bound = compute(keeper(fit.as_ref()))?;
        *place(&mut self.parts) = Some(bound.clone());
        self.keep(fit);
        Ok(bound)
    }

    /// Stores the completed parts, if that is possible. A failure does not end the estimate, because a disk may be full for a while.
    /// After a success the state of the last `fit` is no longer needed.
    fn keep(&mut self, fit: Option<FitFile>) {
        if self.goes_on
            && self.store().is_ok()
            && let Some(fit) = fit
        {
            forget(&fit.path);
        }
    }

    fn store(&mut self) -> Result<(), InformationError> {
        let Some(path) = &self.path else { return Ok(()) };
        self.parts.seconds += std::mem::replace(&mut self.since, Instant::now()).elapsed().as_secs_f64();
        let text = serde_json::to_vec(&ESTIMATE_CHECKPOINT.marked(&self.parts))
            .map_err(|error| failed(path, &error.to_string()))?;
        Ok(write_safely(path, |out| out.write_all(&text))?)
    }

    /// The keeper of the state of a part's fit, in a file of its own.
    fn fit(&self, part: &str) -> Option<FitFile> {
        let path = fit_file(self.path.as_ref()?, part);
        let key = match &self.parts.earlier_key {
            Some(earlier) => earlier_key(&format!("(\n    {earlier:?},\n    {part:?},\n)")),
            None => content_key(&json!([self.parts.key, part])),
        };
        Some(FitFile { path, key })
    }
}

/// Removes the files of an estimate, once its result is stored at its destination.
pub(crate) fn end(path: &Path) {
    // Another estimate may have resumed from it.
    let Ok(_lock) = lock_name(path, &fit_file(path, LOCK)) else { return };
    // Files that cannot be removed do no harm: the next estimate at this path removes them first.
    let _ = forget_fits(path);
    forget(path);
}

/// Removes the states of all fits beside the file of an estimate.
fn forget_fits(path: &Path) -> Result<(), InformationError> {
    for file in fits(path) {
        remove_if_there(&file)?;
    }
    Ok(())
}

/// The states of fits beside the file of an estimate.
fn fits(path: &Path) -> impl Iterator<Item = PathBuf> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let found = std::fs::read_dir(folder).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
    let lock = fit_file(path, LOCK);
    found.filter(move |file| is_checkpoint_file(path, file) && file.file_name() != lock.file_name())
}

/// Whether a file has the name of a file beside the checkpoint: the state of a fit, or the lock.
pub fn is_checkpoint_file(estimate: &Path, file: &Path) -> bool {
    let start = fit_file(estimate, "");
    let names =
        file.file_name().zip(start.file_name()).map(|names| (names.0.to_string_lossy(), names.1.to_string_lossy()));
    let part = names.as_ref().and_then(|(name, start)| name.strip_prefix(&**start)).unwrap_or_default();
    [DECODER, BELOW, ABOVE, LOCK].contains(&part) || part.parse::<usize>().is_ok()
}

/// Names of parts in the files of their fits.
const DECODER: &str = "decoder";
const BELOW: &str = "below";
const ABOVE: &str = "above";
/// Name of the lock of the running estimate.
const LOCK: &str = "lock";

/// Name of a trial, counted from 0.
fn trial_part(index: usize) -> String {
    (index + 1).to_string()
}

/// The file of the state of the fit of a part.
fn fit_file(path: &Path, part: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(format!(".fit-{part}"));
    name.into()
}

fn keeper(fit: Option<&FitFile>) -> Option<&dyn FitCheckpoint> {
    fit.map(|fit| fit as _)
}

/// A key by the scheme from before JSON was hashed.
fn earlier_key(text: &str) -> String {
    blake3::hash(format!("{NUMBERS_VERSION} {text}").as_bytes()).to_hex().to_string()
}

fn failed(path: &Path, reason: &str) -> InformationError {
    InformationError::WeightsFile { path: path.display().to_string(), reason: reason.to_owned() }
}

fn forget(path: &Path) {
    // A file that cannot be removed is replaced, or refused as that of another estimate.
    let _ = std::fs::remove_file(path);
}

#[cfg(test)]
mod tests;
