//! Results for the window: the latest one of every step, with the revision of its design.

use std::sync::Arc;

use crate::evaluation::scene::{LiveInformation, Measurements, Optics, Scene};
use crate::forward::Design;
use crate::information::Estimate;
use crate::workbench::live::inspection::SampleInspection;

/// A result and the revision of the design it was computed from.
#[derive(Debug)]
pub struct Revisioned<T> {
    /// The revision.
    pub revision: u64,
    /// The result, shared.
    pub value: Arc<T>,
}

impl<T> Clone for Revisioned<T> {
    fn clone(&self) -> Self {
        Self { revision: self.revision, value: Arc::clone(&self.value) }
    }
}

/// The latest result of every step; steps arrive one by one.
#[derive(Clone, Default)]
pub struct Live {
    /// PSF and transfer function.
    pub optics: Option<Revisioned<Optics>>,
    /// The objects.
    pub scene: Option<Revisioned<Scene>>,
    /// The measurements.
    pub measurements: Option<Revisioned<Measurements>>,
    /// The information.
    pub information: Option<Revisioned<LiveInformation>>,
    /// The inspection of the one measurement that was requested.
    pub closer: Option<Arc<SampleInspection>>,
    /// Why the newest design has no numbers.
    pub failure: Option<(u64, String)>,
    /// The long computation in progress ("Reading objects: 1200 of 10000").
    pub busy: Option<String>,
    /// Seconds that the last complete evaluation took.
    pub seconds: f64,
}

/// A design whose numbers are wanted.
#[derive(Clone)]
pub(crate) struct Wanted {
    /// Its revision.
    pub revision: u64,
    /// The design.
    pub design: Arc<Design>,
    /// The design before the last edit.
    pub before: Option<Arc<Design>>,
}

/// Whether an estimate of `known` is one of `design`, too, and of its objects as they were read last.
pub(crate) fn is_estimate_of(estimate: &Estimate, known: &Arc<Design>, design: &Arc<Design>, live: &Live) -> bool {
    let objects = live.scene.as_ref().filter(|scene| scene.value.serves(design));
    let is_same = Arc::ptr_eq(known, design) || known == design;
    is_same && objects.is_none_or(|scene| scene.value.set.fingerprint() == estimate.objects_fingerprint)
}
