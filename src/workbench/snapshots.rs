//! Designs that were put aside to be compared, with the numbers they had.

use std::sync::Arc;

use ndarray::{Array2, Axis};

use super::design::Design;
use super::estimator::Estimates;
use super::evaluation::Optics;
use super::export::Curve;
use super::worker::Live;

/// A design that was put aside.
#[derive(Clone)]
pub struct Snapshot {
    /// Tells it from the others, also from those that were deleted.
    pub number: u64,
    /// What a person calls it.
    pub name: String,
    /// The design.
    pub design: Arc<Design>,
    /// Its revision; while it is the open one, its numbers go on getting better.
    revision: u64,
    /// PSF and transfer function.
    pub optics: Option<Arc<Optics>>,
    /// The first of its live measurements, with noise, photons per pixel, shape (rows, cols).
    pub measurement: Option<Array2<f32>>,
    /// Mean Tamura coefficient of its measurements.
    pub tamura: Option<f64>,
    /// Gaussian bound, bits per pixel.
    pub gaussian: Option<f64>,
    /// Object-entropy ceiling, bits per pixel.
    pub ceiling: Option<f64>,
    /// Live estimate and its 95 % interval, bits per pixel, and whether it has settled.
    pub live: Option<(f64, [f64; 2], bool)>,
    /// Largest lower bound of 32 x 32 px patches, bits per pixel.
    pub lower: Option<f64>,
    /// Lower and upper bound of its last bracket of 32 x 32 px patches, bits per pixel.
    pub bracket: Option<[f64; 2]>,
}

impl Snapshot {
    /// The smallest of its upper bounds, bits per pixel.
    pub fn upper(&self) -> Option<f64> {
        let known = [self.live.map(|live| live.0), self.gaussian, self.ceiling, self.bracket.map(|bracket| bracket[1])];
        known.into_iter().flatten().min_by(f64::total_cmp)
    }

    fn take_up(&mut self, live: &Live, estimates: &Estimates) {
        let revision = self.revision;
        if let Some(optics) = live.optics.as_ref().filter(|optics| optics.revision == revision) {
            self.optics = Some(Arc::clone(&optics.value));
        }
        if let Some(measurements) = live.measurements.as_ref().filter(|measured| measured.revision == revision) {
            if self.measurement.is_none() {
                self.measurement = Some(measurements.value.noisy.index_axis(Axis(0), 0).to_owned());
            }
            self.tamura = Some(measurements.value.tamura.mean);
        }
        if let Some(information) = live.information.as_ref().filter(|information| information.revision == revision) {
            self.gaussian = Some(information.value.gaussian.bits_per_pixel);
            self.ceiling = information.value.ceiling_bits();
        }
        if let Some(live) = estimates.live.as_ref().filter(|live| live.revision == revision) {
            self.live = Some((live.value.bits_per_pixel, live.value.interval_95, live.value.remaining.is_none()));
        }
        let finished = estimates.finished.iter().rev().filter(|done| done.revision == revision);
        let brackets = finished.filter_map(|done| {
            let estimate = &done.value.estimate;
            Some([estimate.lower()?, estimate.bits_per_pixel]).filter(|_| estimate.patch == [32, 32])
        });
        self.bracket = brackets.into_iter().next().or(self.bracket);
        let newest = estimates.live.as_ref().filter(|live| live.revision == revision);
        let live = newest.and_then(|live| Some(live.value.lower?.bits_per_pixel));
        let known = [live, self.bracket.map(|bracket| bracket[0])];
        self.lower = known.into_iter().flatten().max_by(f64::total_cmp).or(self.lower);
    }
}

/// All designs that were put aside, oldest first.
#[derive(Default)]
pub struct Snapshots {
    /// The designs.
    pub entries: Vec<Snapshot>,
    last: u64,
}

impl Snapshots {
    /// Most designs that are kept.
    const MOST: usize = 200;

    /// Puts the open design aside.
    ///
    /// # Errors
    /// One sentence where there are too many.
    pub fn keep(
        &mut self,
        (design, revision): (&Arc<Design>, u64),
        live: &Live,
        estimates: &Estimates,
    ) -> Result<(), String> {
        if self.entries.len() >= Self::MOST {
            return Err(format!("{} designs are put aside; delete some before you keep another", Self::MOST));
        }
        self.last += 1;
        let mut snapshot = Snapshot {
            number: self.last,
            name: format!("Design {}", self.last),
            design: Arc::clone(design),
            revision,
            optics: None,
            measurement: None,
            tamura: None,
            gaussian: None,
            ceiling: None,
            live: None,
            lower: None,
            bracket: None,
        };
        snapshot.take_up(live, estimates);
        self.entries.push(snapshot);
        Ok(())
    }

    /// Takes up the newest numbers of designs that are still open.
    pub fn take_up(&mut self, live: &Live, estimates: &Estimates) {
        self.entries.iter_mut().for_each(|snapshot| snapshot.take_up(live, estimates));
    }

    /// The one of this number.
    pub fn get(&self, number: u64) -> Option<&Snapshot> {
        self.entries.iter().find(|snapshot| snapshot.number == number)
    }

    /// All numbers, as a table.
    pub fn table(&self) -> Curve {
        let header = [
            "lenslets",
            "effective_lenslets",
            "live_estimate_bits_per_pixel",
            "live_low_bits_per_pixel",
            "live_high_bits_per_pixel",
            "gaussian_bound_bits_per_pixel",
            "ceiling_bits_per_pixel",
            "lower_bound_bits_per_pixel",
            "upper_bound_bits_per_pixel",
            "sensor_tamura",
        ];
        let known = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let row = |snapshot: &Snapshot| {
            let array = snapshot.design.encoder.lenslets();
            vec![
                known(array.map(|array| array.lenslets.len() as f64)),
                known(array.map(crate::optics::LensletArray::effective_count)),
                known(snapshot.live.map(|live| live.0)),
                known(snapshot.live.map(|live| live.1[0])),
                known(snapshot.live.map(|live| live.1[1])),
                known(snapshot.gaussian),
                known(snapshot.ceiling),
                known(snapshot.lower),
                known(snapshot.upper()),
                known(snapshot.tamura),
            ]
        };
        Curve {
            names: self.entries.iter().map(|snapshot| snapshot.name.clone()).collect(),
            header: header.map(String::from).to_vec(),
            rows: self.entries.iter().map(row).collect(),
        }
    }
}
