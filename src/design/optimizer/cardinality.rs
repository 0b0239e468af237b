//! Runs that end with fewer lenslets than they start with.

use super::IdealOptimizer;
use crate::design::merge::{close_pair, joined};
use crate::design::projection::project;

/// Share of the steps after which the mask has the final number of lenslets.
const PRUNED_BY: f64 = 0.6;

impl IdealOptimizer<'_> {
    /// Removes lenslets down to the number that the schedule allows at this step: one of a close pair, otherwise the darkest.
    pub(super) fn prune(&mut self) {
        let Some(wanted) = self.settings.cardinality else { return };
        let state = &mut self.state;
        let all = state.array.lenslets.len();
        let share = (state.step as f64 / self.settings.steps as f64 / PRUNED_BY).min(1.0);
        let allowed = all - ((all.saturating_sub(wanted)) as f64 * share).floor() as usize;
        while all - state.pruned.len() > allowed.max(1) {
            let free = self.settings.free_lenslets(all, &state.pruned);
            let out = if let Some((one, other)) = close_pair(&state.array, &free) {
                let lenslets = &mut state.array.lenslets;
                lenslets[one] = joined(lenslets[one], lenslets[other], self.settings.free);
                other
            } else {
                let weight = |index: usize| state.array.lenslets[index].weight;
                let darkest = free.iter().copied().min_by(|&one, &other| weight(one).total_cmp(&weight(other)));
                let Some(darkest) = darkest else { return };
                darkest
            };
            state.array.lenslets[out].weight = 0.0;
            state.pruned.push(out);
            state.model_up_to_date = false;
        }
        project(&mut state.array, &self.settings, &self.limits);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::beads;
    use super::*;
    use crate::design::settings::{Free, IdealSettings, Objective, Preset};
    use crate::forward::ForwardModel;
    use crate::optics::{Lenslet, LensletArray, Limits};
    use crate::sensor::Noise;

    #[test]
    fn pruning_joins_free_lenslets_only_and_keeps_fixed_weights() {
        let set = beads();
        let forward = ForwardModel::new(set.clone(), (12, 12), 10.0, Noise::Shot).unwrap();
        let lenslets = [2.0, 2.1, 6.0, 6.4, 9.0].map(|x| Lenslet::round(x, 5.0, 1.0, 0.2)).to_vec();
        let start = LensletArray::new(12, 12, lenslets);
        let settings = IdealSettings {
            patch: Some((6, 6)),
            cardinality: Some(4),
            locked: vec![0],
            free: Free { weights: false, ..Free::default() },
            steps: 10,
            ..IdealSettings::new(Preset::Default, Objective::Posterior, 1)
        };
        let mut ideal = IdealOptimizer::new(&forward, &start, Limits::default(), settings).unwrap();
        ideal.state.step = 10;
        ideal.prune();
        assert_eq!(ideal.state.pruned, [3]);
        let found: Vec<(f64, f64)> = ideal.state.array.lenslets.iter().map(|one| (one.x, one.weight)).collect();
        assert!((found[2].0 - 6.2).abs() < 1e-9, "{found:?}");
        assert!(
            [0, 1, 2, 4].iter().all(|&index| (found[index].1 - 0.2).abs() < 1e-12) && found[3].1 == 0.0,
            "{found:?}"
        );
    }
}
