//! Trajectories of the lenslets of a run, drawn over the image of its mask.

use std::ops::RangeInclusive;

use egui::{Stroke, Ui};

use crate::design::{Checkpoint, IdealEvent};
use crate::optics::{Lenslet, LensletArray};
use crate::studio::canvas::viewport::Placement;
use crate::studio::state::view::View;
use crate::studio::widgets::colours::TRAJECTORY;

/// Draws the trajectories of all lenslets where the mask belongs to the last run, the bright ones more clearly.
pub fn draw(ui: &Ui, view: &View<'_>, placement: Placement, array: &LensletArray) {
    let Some(run) = view.run_with_trajectories() else { return };
    let shown = run.checkpoints.iter().position(|checkpoint| checkpoint.array == *array);
    let is_newest = *run.array == *array;
    let is_other = |checkpoint: &Checkpoint| checkpoint.array.lenslets.len() != array.lenslets.len();
    if (shown.is_none() && !is_newest) || run.checkpoints.iter().any(is_other) {
        return;
    }
    let brightest = array.lenslets.iter().map(|lenslet| lenslet.weight).fold(0.0, f64::max);
    for (index, lenslet) in array.lenslets.iter().enumerate() {
        let way = way(&run.checkpoints, &run.events, shown, index).chain([lenslet]);
        let points: Vec<_> = way.map(|lenslet| placement.to_screen(lenslet.x, lenslet.y)).collect();
        let share = (lenslet.weight / brightest.max(1e-12)) as f32;
        let stroke = Stroke::new(1.5, TRAJECTORY.gamma_multiply(0.25 + 0.75 * share));
        ui.painter().add(egui::Shape::line(points, stroke));
    }
}

/// States of a lenslet in the checkpoints up to the shown one, or up to the newest where none is shown.
fn way<'a>(
    checkpoints: &'a [Checkpoint],
    events: &[IdealEvent],
    shown: Option<usize>,
    index: usize,
) -> impl Iterator<Item = &'a Lenslet> {
    let before = &checkpoints[..shown.map_or(checkpoints.len(), |shown| shown + 1)];
    let last = before.last().map_or(0, |checkpoint| checkpoint.step);
    // Masks that the run discarded by a revert are not part of the trajectory.
    let given_up = |at: usize| {
        let until_then = |steps: &RangeInclusive<usize>| *steps.end() <= last;
        events.iter().filter_map(IdealEvent::discarded_steps).filter(until_then).any(|steps| steps.contains(&at))
    };
    // A relocated lenslet starts a new trajectory.
    let relocated = |event: &IdealEvent| match *event {
        IdealEvent::Relocated { step, lenslet } if lenslet == index && !given_up(step) => {
            // Where a finished run was resumed, two checkpoints have the same step. The later one follows the relocation;
            // it may not exist yet.
            let at = checkpoints.iter().rposition(|checkpoint| checkpoint.step == step).unwrap_or(checkpoints.len());
            (at < before.len() || shown.is_none()).then_some(at)
        }
        _ => None,
    };
    let since = events.iter().filter_map(relocated).max().unwrap_or(0);
    let kept: Vec<_> = before[since..].iter().filter(|checkpoint| !given_up(checkpoint.step)).collect();
    kept.into_iter().map(move |checkpoint| &checkpoint.array.lenslets[index])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checkpoints every ten steps with a lenslet at x = steps / 10.
    fn checkpoints(count: usize) -> Vec<Checkpoint> {
        let checkpoint = |number: usize| Checkpoint {
            step: 10 * number,
            array: LensletArray::new(32, 32, vec![Lenslet::round(number as f64, 5.0, 1.0, 1.0)]),
            bits_per_pixel: 0.1,
            interval_95: [0.0, 0.2],
            lower: None,
            tamura: 1.0,
            cold_fit_bits: None,
            distinct_lenslets: 1,
            effective_lenslets: 1.0,
            seconds: 1.0,
        };
        (0..count).map(checkpoint).collect()
    }

    fn visited(checkpoints: &[Checkpoint], events: &[IdealEvent], shown: Option<usize>) -> Vec<f64> {
        way(checkpoints, events, shown, 0).map(|lenslet| lenslet.x).collect()
    }

    #[test]
    fn a_way_leads_to_the_mask_that_is_shown() {
        assert_eq!(visited(&checkpoints(4), &[], Some(2)), [0.0, 1.0, 2.0]);
        assert_eq!(visited(&checkpoints(4), &[], None), [0.0, 1.0, 2.0, 3.0]);
        assert!(visited(&[], &[], None).is_empty());
    }

    #[test]
    fn a_lenslet_that_got_light_elsewhere_took_no_way_there() {
        let relocated = [IdealEvent::Relocated { step: 20, lenslet: 0 }];
        assert_eq!(visited(&checkpoints(4), &relocated, None), [2.0, 3.0]);
        assert_eq!(visited(&checkpoints(4), &relocated, Some(1)), [0.0, 1.0], "it was still to come");
        assert!(visited(&checkpoints(2), &relocated, None).is_empty(), "its checkpoint is still to come");
        let other = [IdealEvent::Relocated { step: 20, lenslet: 1 }];
        assert_eq!(visited(&checkpoints(4), &other, None), [0.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn masks_that_a_run_came_back_from_are_not_on_the_way() {
        let returned = IdealEvent::Reverted { step: 30, to: 10 };
        assert_eq!(visited(&checkpoints(6), std::slice::from_ref(&returned), None), [0.0, 1.0, 4.0, 5.0]);
        assert_eq!(visited(&checkpoints(6), std::slice::from_ref(&returned), Some(2)), [0.0, 1.0, 2.0]);
        // A revert restores the positions before a relocation.
        let events = [IdealEvent::Relocated { step: 20, lenslet: 0 }, returned];
        assert_eq!(visited(&checkpoints(6), &events, None), [0.0, 1.0, 4.0, 5.0]);
    }
}
