//! The schedule of the live estimate: times and lengths of its steps.

use std::time::Duration;

/// The schedule of a live estimate. Times count from the start of a fit where nothing else is said.
#[derive(Clone, Copy)]
pub(crate) struct LiveSchedule {
    /// Time for the steps of a fit from a cold start.
    pub cold_fit: Duration,
    /// Time for the steps of a fit from the model of a similar design.
    pub warm_fit: Duration,
    /// Steps from which the pace of the first fit is measured.
    pub paced_steps: usize,
    /// Fewest and most steps of a fit.
    pub planned_steps: (f64, f64),
    /// Times from the start of a fit to its first scores, and the held-out patches of each.
    pub first_scores: [(Duration, usize); 2],
    /// Time from an edit to the next score. By then the pace of a first fit is known well enough to plan its rest.
    pub score_after_edit: Duration,
    /// Factor from the time of one later score to the time of the next.
    pub score_interval_growth: f64,
    /// Time from the start of a fit after which position gradients come after each score.
    pub first_gradients: Duration,
    /// Time for position gradients during a fit.
    pub gradients: Duration,
    /// Time for position gradients once the estimate has converged.
    pub gradients_converged: Duration,
    /// Time for position gradients once all bounds are there.
    pub gradients_last: Duration,
    /// Time from the start of a fit after which the decoder's lower bound is computed.
    pub first_decoder_bound: Duration,
    /// Most samples of that bound during a fit.
    pub decoder_samples: usize,
    /// Most samples of that bound once the estimate has converged.
    pub decoder_samples_converged: usize,
    /// Time from the start of a fit after which annealed importance sampling runs.
    pub first_ais: Duration,
    /// Time for each bound by annealed importance sampling during a fit.
    pub ais: Duration,
    /// Time for each bound by annealed importance sampling once the estimate has converged.
    pub ais_converged: Duration,
    /// Most samples of the decoder's bound for whole measurements, which come last.
    pub decoder_samples_sensor: usize,
    /// Time for each bound of whole measurements by annealed importance sampling.
    pub ais_sensor: Duration,
    /// Samples of the comparison with the design before the last edit, soon after it.
    pub edit_samples: usize,
    /// Samples of the comparison once the estimate has converged.
    pub edit_samples_converged: usize,
    /// Time for the upper bound by annealed importance sampling soon after an edit.
    pub ais_after_edit: Duration,
    /// Bits per pixel by which that bound must have lowered the smallest upper bound before the edit to be computed so soon.
    pub least_gain: f64,
    /// Held-out patches of the score of a converged estimate.
    pub score_patches_converged: usize,
    /// Held-out patches of later scores during a fit.
    pub score_patches: usize,
}

/// The schedule of the window. On two cores the first number comes within half a second, and the estimate converges in about twenty.
pub(crate) const SCHEDULE: LiveSchedule = LiveSchedule {
    cold_fit: Duration::from_mins(1),
    warm_fit: Duration::from_secs(20),
    paced_steps: 8,
    planned_steps: (200.0, 100_000.0),
    first_scores: [(Duration::from_millis(150), 32), (Duration::from_millis(1200), 96)],
    score_after_edit: Duration::from_millis(4750),
    score_interval_growth: 1.7,
    first_gradients: Duration::from_secs(4),
    gradients: Duration::from_millis(400),
    gradients_converged: Duration::from_secs(3),
    gradients_last: Duration::from_secs(6),
    first_decoder_bound: Duration::from_millis(700),
    decoder_samples: 256,
    decoder_samples_converged: 2048,
    first_ais: Duration::from_secs(3),
    ais: Duration::from_secs(3),
    ais_converged: Duration::from_secs(8),
    decoder_samples_sensor: 256,
    ais_sensor: Duration::from_secs(10),
    edit_samples: 128,
    edit_samples_converged: 512,
    ais_after_edit: Duration::from_secs(1),
    least_gain: 0.01,
    score_patches_converged: 384,
    score_patches: 192,
};

impl Default for LiveSchedule {
    fn default() -> Self {
        SCHEDULE
    }
}

impl LiveSchedule {
    /// The schedule with all times divided by `speed`. Counts stay, so that its numbers are as reproducible.
    #[must_use]
    pub fn at_speed(self, speed: f64) -> Self {
        let faster = |time: Duration| Duration::try_from_secs_f64(time.as_secs_f64() / speed).unwrap_or(time);
        Self {
            cold_fit: faster(self.cold_fit),
            warm_fit: faster(self.warm_fit),
            first_scores: self.first_scores.map(|(after, patches)| (faster(after), patches)),
            score_after_edit: faster(self.score_after_edit),
            first_gradients: faster(self.first_gradients),
            gradients: faster(self.gradients),
            gradients_converged: faster(self.gradients_converged),
            gradients_last: faster(self.gradients_last),
            first_decoder_bound: faster(self.first_decoder_bound),
            first_ais: faster(self.first_ais),
            ais: faster(self.ais),
            ais_converged: faster(self.ais_converged),
            ais_sensor: faster(self.ais_sensor),
            ais_after_edit: faster(self.ais_after_edit),
            ..self
        }
    }
}
