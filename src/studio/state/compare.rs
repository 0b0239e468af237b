//! The comparison of snapshots.

use std::collections::HashMap;

use egui::TextureHandle;

use crate::studio::canvas::image_view::ImageView;
use crate::studio::canvas::viewport::Viewport;
use crate::workbench::{Colormap, Job, Snapshots};

/// State of the Compare panel.
pub struct CompareState {
    /// Snapshots of designs.
    pub snapshots: Snapshots,
    /// Numbers of the two designs.
    pub pair: [Option<u64>; 2],
    /// What is shown of them.
    pub side: ComparedSide,
    /// The compared quantity.
    pub what: Quantity,
    /// The user has just chosen a design or the measurement: failed simulations are repeated.
    pub tries_again: bool,
    /// Image of one design.
    pub image: ImageView,
    /// Image of the difference.
    pub difference: ImageView,
    /// Their common zoom and pan.
    pub viewport: Viewport,
    /// PSFs in the table, by number of the snapshot.
    pub thumbnails: HashMap<u64, TextureHandle>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub enum ComparedSide {
    A,
    B,
    Difference,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    Psf,
    Measurement,
    Mtf,
}

impl Default for CompareState {
    fn default() -> Self {
        Self {
            snapshots: Snapshots::default(),
            pair: [None; 2],
            side: ComparedSide::A,
            what: Quantity::Psf,
            tries_again: false,
            image: ImageView::new("Comparison", "", Colormap::Viridis),
            difference: ImageView::new("Difference", "", Colormap::Diverging),
            viewport: Viewport::default(),
            thumbnails: HashMap::new(),
        }
    }
}

impl CompareState {
    /// Compares a new snapshot at once where one side of the pair is free.
    pub fn compare_new(&mut self, number: u64) {
        if let Some(free) = self.pair.iter_mut().find(|chosen| chosen.is_none()) {
            *free = Some(number);
        }
    }

    /// Deletes a snapshot.
    pub fn delete(&mut self, number: u64) {
        self.snapshots.delete(number);
        self.thumbnails.remove(&number);
    }

    /// Jobs for missing measurements of the pair, each requested once; snapshots are stored without them.
    pub fn missing_measurements(&mut self) -> Vec<Job> {
        let tries_again = std::mem::take(&mut self.tries_again);
        let mut jobs = Vec::new();
        for number in self.pair.into_iter().flatten() {
            let snapshot = self.snapshots.entries.iter_mut().find(|snapshot| snapshot.number == number);
            let Some(snapshot) = snapshot else { continue };
            if tries_again {
                snapshot.forget_failed_measurement();
            }
            if snapshot.wants_measurement() {
                let (name, design) = (snapshot.name.clone(), snapshot.design.clone());
                jobs.push(Job::MeasureSnapshot { number, name, design });
            }
        }
        jobs
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::forward::Design;
    use crate::workbench::LiveResults;

    fn with_snapshots(count: usize) -> CompareState {
        let mut compare = CompareState::default();
        for _ in 0..count {
            let design = Arc::new(Design::default());
            let (live, estimates, reconstructions) = Default::default();
            let results = LiveResults { live: &live, estimates: &estimates, reconstructions: &reconstructions };
            compare.snapshots.keep(&design, 1, results).unwrap();
            compare.compare_new(compare.snapshots.entries.last().unwrap().number);
        }
        compare
    }

    #[test]
    fn first_two_snapshots_are_compared() {
        let mut compare = with_snapshots(3);
        assert_eq!(compare.pair, [Some(1), Some(2)]);
        compare.pair[0] = None;
        compare.compare_new(9);
        assert_eq!(compare.pair, [Some(9), Some(2)]);
    }

    #[test]
    fn measurements_are_requested_once_and_failed_ones_again_after_a_choice() {
        let mut compare = with_snapshots(2);
        assert_eq!(compare.missing_measurements().len(), 2);
        assert!(compare.missing_measurements().is_empty());
        compare.snapshots.set_measurement(1, Err("the disk is full".into()));
        assert!(compare.missing_measurements().is_empty(), "the failure is shown");
        compare.tries_again = true;
        assert!(matches!(compare.missing_measurements()[..], [Job::MeasureSnapshot { number: 1, .. }]));
    }
}
