//! Estimates that came to their end, in files of their own, so that they outlive the window.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::design::Design;
use super::estimation::EstimateRequest;
use super::measured::MeasuredOrder;
use super::progress::FitPoint;
use super::worker::Live;
use crate::formats::{FormatError, create_folder, read_json, write_json};
use crate::information::{Estimate, NUMBERS_VERSION};

/// An estimate that was asked for.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct EstimateOrder {
    /// The design as it was then.
    pub design: Arc<Design>,
    /// Its revision; those of another day count for nothing.
    #[serde(skip)]
    pub revision: u64,
    /// What is to be estimated.
    pub request: EstimateRequest,
    /// Images of a camera in place of the design's measurements, of which it has noise and seed alone.
    pub measured: Option<MeasuredOrder>,
}

/// A finished order with the curves of its fits.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FinishedEstimate {
    /// Version of the program's numbers.
    program_version: String,
    /// What was asked for.
    pub order: EstimateOrder,
    /// The result.
    pub estimate: Estimate,
    /// Curves of the fits, oldest first.
    pub curve: Vec<FitPoint>,
    /// Name of its file, if it has one.
    #[serde(skip)]
    file: Option<String>,
}

impl FinishedEstimate {
    /// An estimate of today.
    pub(super) fn new(order: EstimateOrder, estimate: Estimate, mut curve: Vec<FitPoint>) -> Self {
        curve.retain(|point| point.bits.is_finite());
        Self { program_version: NUMBERS_VERSION.into(), order, estimate, curve, file: None }
    }

    /// Whether this version of the program would compute the same.
    pub fn is_of_this_version(&self) -> bool {
        self.program_version == NUMBERS_VERSION
    }

    /// Whether it is of this design, whatever revision that has by now, and of its objects as they were read last.
    pub fn is_of(&self, design: &Arc<Design>, live: &Live) -> bool {
        self.order.measured.is_none()
            && self.is_of_this_version()
            && is_estimate_of((&self.estimate, &self.order.design), design, live)
    }
}

/// Whether an estimate of `known` is one of `design`, too, and of its objects as they were read last.
pub(super) fn is_estimate_of((estimate, known): (&Estimate, &Arc<Design>), design: &Arc<Design>, live: &Live) -> bool {
    let objects = live.scene.as_ref().filter(|scene| scene.value.serves(design));
    let is_same = Arc::ptr_eq(known, design) || known == design;
    is_same && objects.is_none_or(|scene| scene.value.set.fingerprint() == estimate.objects_fingerprint)
}

/// A folder with a file for each.
#[derive(Clone, Debug)]
pub(super) struct FinishedFolder(PathBuf);

impl FinishedFolder {
    /// Most estimates that are read; older ones stay in their files.
    const MOST: usize = 100;

    /// The folder, which is made if need be.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub fn new(folder: &Path) -> Result<Self, FormatError> {
        create_folder(folder)?;
        Ok(Self(folder.to_path_buf()))
    }

    /// The newest of them, oldest first. What cannot be read is left as it is.
    pub fn read(&self) -> Vec<FinishedEstimate> {
        let Ok(entries) = std::fs::read_dir(&self.0) else { return Vec::new() };
        let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        files.retain(|file| file.extension().is_some_and(|ending| ending == "json"));
        // Sorted by name they are in the order in which they came.
        files.sort();
        let newest = files.iter().skip(files.len().saturating_sub(Self::MOST));
        let read = |path: &PathBuf| {
            let estimate: FinishedEstimate = read_json(path).ok()?;
            estimate.order.design.check().ok()?;
            Some(FinishedEstimate { file: Some(path.file_name()?.to_string_lossy().into_owned()), ..estimate })
        };
        newest.filter_map(read).collect()
    }

    /// Writes one into a file of its own.
    ///
    /// # Errors
    /// Where that cannot be written.
    pub fn keep(&self, estimate: &mut FinishedEstimate) -> Result<(), FormatError> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let name = format!("{:024}-{}.json", now.as_nanos(), std::process::id());
        write_json(&self.0.join(&name), estimate)?;
        estimate.file = Some(name);
        Ok(())
    }

    /// Deletes the file of one.
    pub fn delete(&self, estimate: &FinishedEstimate) {
        if let Some(name) = &estimate.file {
            // One that is gone already need not go.
            let _ = std::fs::remove_file(self.0.join(name));
        }
    }
}
