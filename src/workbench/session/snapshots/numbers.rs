//! Numbers of a snapshot.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::forward::Design;
use crate::information::{Bracket, Estimator, NamedBound, Protocol};
use crate::reconstruction::DecoderKind;
use crate::workbench::estimates::queue::Estimates;
use crate::workbench::live::published::Live;
use crate::workbench::reconstructions::queue::{Reconstructions, SetQuality};

/// Bits per pixel with their 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bits {
    /// Bits per pixel.
    pub bits: f64,
    /// 95 % interval.
    pub interval_95: [f64; 2],
}

impl Bits {
    /// Half the width of the interval.
    pub fn half_width(&self) -> f64 {
        0.5 * (self.interval_95[1] - self.interval_95[0])
    }
}

/// PSNR of a decoder on a test set, with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SnapshotReconstruction {
    /// The decoder.
    pub decoder: DecoderKind,
    /// PSNR, dB.
    pub psnr_db: f64,
    /// Its interval.
    pub interval_95: [f64; 2],
    /// Number of test objects.
    pub test_objects: usize,
}

impl SnapshotReconstruction {
    fn of(set: &SetQuality) -> Self {
        let quality = &set.quality;
        Self {
            decoder: quality.decoder,
            psnr_db: quality.psnr_db,
            interval_95: quality.psnr_db_interval_95,
            test_objects: quality.test_objects,
        }
    }
}

/// Results of the open design that numbers of snapshots are taken from.
#[derive(Clone, Copy)]
pub struct LiveResults<'a> {
    /// Results of the worker.
    pub live: &'a Live,
    /// Longer estimates.
    pub estimates: &'a Estimates,
    /// Reconstructions.
    pub reconstructions: &'a Reconstructions,
}

/// Numbers of a design, in bits per pixel except for the Tamura coefficient.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SnapshotNumbers {
    /// Fingerprint of the objects of the other numbers.
    #[serde(default)]
    pub(crate) objects: Option<String>,
    /// Mean Tamura coefficient of its measurements.
    pub tamura: Option<f64>,
    /// Gaussian bound, or approximation.
    pub gaussian: Option<Bits>,
    /// Whether the Gaussian number is a bound, where that is known.
    #[serde(default)]
    pub(crate) gaussian_is_bound: Option<bool>,
    /// Object-entropy bound.
    pub ceiling: Option<f64>,
    /// Live estimate, and whether it has converged.
    pub live: Option<(Bits, bool)>,
    /// Upper bound by annealed importance sampling.
    pub sampled: Option<Bits>,
    /// Largest lower bound of 32 x 32 px patches.
    pub lower: Option<Bits>,
    /// Lower and upper bound of its last bracket of 32 x 32 px patches.
    pub bracket: Option<[Bits; 2]>,
    /// Smallest upper bound by finished estimates of 32 x 32 px patches.
    #[serde(default)]
    pub fitted: Option<Bits>,
    /// PSNR of every decoder that was chosen while the design was open.
    #[serde(default)]
    pub reconstructions: Vec<SnapshotReconstruction>,
}

impl SnapshotNumbers {
    /// Removes numbers of objects with another fingerprint: earlier contents of the files do not describe the present ones. Returns
    /// whether numbers were removed.
    pub(crate) fn are_of(&mut self, objects: String) -> bool {
        let others = self.objects.as_ref().is_some_and(|before| *before != objects);
        if others {
            *self = Self::default();
        }
        self.objects = Some(objects);
        others
    }

    /// Replaces the number of a decoder, unless the known one is of more test objects.
    fn note_reconstruction(&mut self, newest: SnapshotReconstruction) {
        match self.reconstructions.iter_mut().find(|known| known.decoder == newest.decoder) {
            Some(known) if known.test_objects > newest.test_objects => {}
            Some(known) => *known = newest,
            None => self.reconstructions.push(newest),
        }
    }

    /// PSNR of a decoder, where it is known.
    pub fn reconstruction_by(&self, decoder: DecoderKind) -> Option<&SnapshotReconstruction> {
        self.reconstructions.iter().find(|known| known.decoder == decoder)
    }

    /// Updates the numbers of the open design, of this revision.
    pub(crate) fn take_up(&mut self, (design, revision): (&Arc<Design>, u64), results: LiveResults<'_>) {
        let LiveResults { live, estimates, reconstructions } = results;
        if let Some(set) = reconstructions.set.as_ref().filter(|set| set.key.revision == revision) {
            self.note_reconstruction(SnapshotReconstruction::of(set));
        }
        if let Some(measurements) = live.measurements.as_ref().filter(|measured| measured.revision == revision) {
            self.tamura = Some(measurements.value.tamura.mean);
        }
        if let Some(information) = live.information.as_ref().filter(|information| information.revision == revision) {
            let (bits, interval_95) = (information.value.gaussian.bits_per_pixel, information.value.interval_95);
            self.gaussian = Some(Bits { bits, interval_95 });
            self.gaussian_is_bound = Some(information.value.gaussian_is_bound);
            self.ceiling = information.value.ceiling_bits();
        }
        // A converged number gives way to a converged one, not to the first numbers of another fit.
        let has_settled = self.live.is_some_and(|(_, settled)| settled);
        let newest = estimates.live.as_ref().filter(|live| live.revision == revision);
        let newest = newest.filter(|live| live.value.remaining.is_none() || !has_settled);
        if let Some(live) = newest {
            let (bits, interval_95) = (live.value.bits_per_pixel, live.value.interval_95);
            self.live = Some((Bits { bits, interval_95 }, live.value.remaining.is_none()));
        }
        let finished = || {
            let of_design = estimates.finished.iter().rev().filter(|done| done.value.is_of(design, live));
            of_design.map(|done| &done.value.estimate)
        };
        let fitted = finished()
            .filter(|estimate| estimate.patch == [32, 32] && estimate.protocol == Protocol::Default)
            .map(|estimate| Bits { bits: estimate.bits_per_pixel, interval_95: estimate.interval_95 });
        self.fitted = fitted.chain(self.fitted).min_by(|one, other| one.bits.total_cmp(&other.bits));
        // Other estimates have an immediate lower bound, which is looser.
        let brackets = finished().filter(|estimate| estimate.estimator == Estimator::Bracket).filter_map(|estimate| {
            let Bracket { lower, lower_interval_95, upper, upper_interval_95, .. } = estimate.bracket.as_ref()?;
            let below = Bits { bits: (*lower)?, interval_95: (*lower_interval_95)? };
            let above = Bits { bits: *upper, interval_95: *upper_interval_95 };
            Some([below, above]).filter(|_| estimate.patch == [32, 32])
        });
        self.bracket = brackets.into_iter().next().or(self.bracket);
        let bits = |bound: &NamedBound| Bits { bits: bound.bits_per_pixel, interval_95: bound.interval_95 };
        let live = newest.and_then(|live| live.value.lower.as_ref().map(bits));
        let above = newest.and_then(|live| live.value.upper.as_ref().map(bits));
        self.sampled = above.or(self.sampled);
        let before = self.lower.filter(|_| newest.is_none());
        let known = [live, self.bracket.map(|bracket| bracket[0]), before];
        let largest = known.into_iter().flatten().max_by(|one, other| one.bits.total_cmp(&other.bits));
        self.lower = largest.or(self.lower);
    }
}
