//! The request of an estimate: the density model, the length of its fits, and the number of patches.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::evaluation::checkpoint;
use crate::formats::path_text;
use crate::information::{EngineChoice, Estimator, FitLength, InformationError, Init, Protocol, check_causal_patch};

/// The density model of an estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DensityModel {
    /// Stationary Gaussian, fitted to patches.
    Stationary,
    /// Full-covariance Gaussian, fitted to patches.
    GaussianFull,
    /// Gaussian of the covariance that objects and PSF have; patches serve the noise entropy alone.
    Analytic,
    /// The published autoregressive network, fitted to patches.
    PixelCnn {
        /// Time for the fit of each trial; without it the protocol decides the length of a fit.
        budget: Option<Duration>,
        /// Engine that computes the network.
        engine: EngineChoice,
    },
    /// The causal density model over clean intensities, fitted to fresh patches for this length. For beads, whose prior is known, the
    /// estimate is the smallest of its bound, the object-entropy bound and annealed importance sampling. The latter gets three sixteenths
    /// of the time.
    Causal {
        /// Time of each trial, or steps of its fit.
        length: FitLength,
    },
    /// Lower and upper bound. The upper bound is the smallest of the causal density model, the Gaussian bound, the object-entropy bound
    /// and annealed importance sampling. The lower bound comes from a decoder and annealed importance sampling. There is one trial,
    /// whatever is requested.
    Bracket {
        /// Total time for the fits of density model and decoder and for annealed importance sampling, or steps of each fit.
        length: FitLength,
    },
}

impl DensityModel {
    /// The model of an estimator, fitted for `budget`. Without a budget a PixelCNN is fitted as its protocol says, the others for their
    /// [usual](Estimator::default_budget) time. Estimators that are not fitted for a time ignore it.
    pub fn new(estimator: Estimator, budget: Option<Duration>, engine: EngineChoice) -> Self {
        let length = FitLength::Time(budget.or(estimator.default_budget()).unwrap_or_default());
        match estimator {
            Estimator::GaussianStationary => Self::Stationary,
            Estimator::GaussianFull => Self::GaussianFull,
            Estimator::GaussianAnalytic => Self::Analytic,
            Estimator::PixelCnn => Self::PixelCnn { budget, engine },
            Estimator::Causal => Self::Causal { length },
            Estimator::Bracket => Self::Bracket { length },
        }
    }

    /// The same model with fits of `steps` steps. They give the same bits whenever they are repeated on one machine. Models that are not
    /// fitted for a time stay unchanged.
    #[must_use]
    pub fn of_steps(self, steps: usize) -> Self {
        let length = FitLength::Steps(steps);
        match self {
            Self::Causal { .. } => Self::Causal { length },
            Self::Bracket { .. } => Self::Bracket { length },
            other => other,
        }
    }

    /// Length of the fits, where one was requested.
    pub fn length(&self) -> Option<FitLength> {
        match self {
            Self::Stationary | Self::GaussianFull | Self::Analytic => None,
            Self::PixelCnn { budget, .. } => budget.map(FitLength::Time),
            Self::Causal { length, .. } | Self::Bracket { length } => Some(*length),
        }
    }

    /// Refuses a patch, rows and columns in pixels, that is too large for the model, before thousands are drawn.
    pub(crate) fn check_patch(&self, patch: (usize, usize)) -> Result<(), InformationError> {
        match self {
            Self::Causal { .. } | Self::Bracket { .. } => check_causal_patch(patch),
            Self::Stationary | Self::GaussianFull | Self::Analytic | Self::PixelCnn { .. } => Ok(()),
        }
    }

    /// Identity of the model and of the length of its fits, by fixed names.
    fn identity(&self) -> Value {
        let name = match self {
            Self::Stationary => "gaussian",
            Self::GaussianFull => "gaussian-full",
            Self::Analytic => "gaussian-analytic",
            Self::PixelCnn { .. } => "pixelcnn",
            Self::Causal { .. } => "causal",
            Self::Bracket { .. } => "bracket",
        };
        let engine = if let Self::PixelCnn { engine, .. } = self { Some(engine.to_string()) } else { None };
        let length = self.length().map(|length| match length {
            FitLength::Time(time) => json!({ "seconds": time.as_secs_f64() }),
            FitLength::Steps(steps) => json!({ "steps": steps }),
        });
        json!({ "name": name, "engine": engine, "length": length })
    }

    /// The texts for the model in keys of earlier versions.
    fn earlier_names(&self) -> Vec<String> {
        let length = |length: FitLength| match length {
            FitLength::Time(time) => format!("Time({time:?})"),
            FitLength::Steps(steps) => format!("Steps({steps})"),
        };
        match *self {
            Self::Stationary => vec!["Stationary".to_owned()],
            Self::GaussianFull => vec!["Full".to_owned()],
            Self::Analytic => vec!["Analytic".to_owned()],
            Self::PixelCnn { budget, engine } => {
                let engine = match engine {
                    EngineChoice::Cpu => "Cpu".to_owned(),
                    EngineChoice::Burn(device) => format!("Burn({device:?})"),
                };
                vec![format!("PixelCnn {{ budget: {budget:?}, engine: {engine} }}")]
            }
            Self::Causal { length: of } => {
                let named = |name| format!("Causal {{ estimator: {name}, length: {} }}", length(of));
                ["Live", "Full"].map(named).into()
            }
            Self::Bracket { length: of } => vec![format!("Bracket {{ length: {} }}", length(of))],
        }
    }

    /// The estimator of this model.
    pub fn estimator(&self) -> Estimator {
        match self {
            Self::Stationary => Estimator::GaussianStationary,
            Self::GaussianFull => Estimator::GaussianFull,
            Self::Analytic => Estimator::GaussianAnalytic,
            Self::PixelCnn { .. } => Estimator::PixelCnn,
            Self::Causal { .. } => Estimator::Causal,
            Self::Bracket { .. } => Estimator::Bracket,
        }
    }
}

/// Settings of an estimate.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let request = EstimateRequest::new(Estimator::GaussianStationary).with_patch(16, 16).with_patches(2_000, 400);
/// assert_eq!(request.patch, Some((16, 16)));
/// assert_eq!(request.trials, 1);
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EstimateRequest {
    /// The density model.
    pub model: DensityModel,
    /// The protocol.
    pub protocol: Protocol,
    /// Rows and columns of a patch in pixels; `None` takes whole measurements.
    pub patch: Option<(usize, usize)>,
    /// Number of training patches.
    pub patches_train: usize,
    /// Number of held-out patches of the score.
    pub patches_test: usize,
    /// Whether fits of causal and bracket start from random weights, in place of the pretrained ones.
    pub fresh: bool,
    /// Number of trials; trial t uses seed + t.
    pub trials: usize,
    /// Checkpoint file, from which the same request resumes. Beside it lies the state of the running fit. Both stay until
    /// [`EstimateRequest::end_kept`].
    pub keep: Option<PathBuf>,
    /// Files of the weights of a `PixelCNN`.
    pub weights: WeightsFiles,
}

/// Files of the weights of a `PixelCNN`, safetensors.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WeightsFiles {
    /// Weights that are scored as they are, without a fit.
    pub from: Option<PathBuf>,
    /// Destination of the weights of the smallest trial.
    pub to: Option<PathBuf>,
}

impl Default for EstimateRequest {
    /// A fitted stationary Gaussian, patches of 32 x 32 px, 10,000 for training and 1,500 for the test: the defaults of the
    /// command `estimate`.
    fn default() -> Self {
        Self {
            model: DensityModel::Stationary,
            protocol: Protocol::Default,
            patch: Some((32, 32)),
            patches_train: 10_000,
            patches_test: 1_500,
            fresh: false,
            trials: 1,
            keep: None,
            weights: WeightsFiles::default(),
        }
    }
}

impl EstimateRequest {
    /// The default request for an estimator, with its usual time for fits.
    pub fn new(estimator: Estimator) -> Self {
        Self { model: DensityModel::new(estimator, None, EngineChoice::default()), ..Self::default() }
    }

    /// The same request with fits of at most this time in each trial.
    #[must_use]
    pub fn with_budget(self, budget: Duration) -> Self {
        let engine =
            if let DensityModel::PixelCnn { engine, .. } = self.model { engine } else { EngineChoice::default() };
        Self { model: DensityModel::new(self.model.estimator(), Some(budget), engine), ..self }
    }

    /// The same request with fits of this number of steps: equal seeds then give equal numbers on one machine.
    #[must_use]
    pub fn with_steps(self, steps: usize) -> Self {
        Self { model: self.model.of_steps(steps), ..self }
    }

    /// The same request with patches of this number of rows and columns of pixels.
    #[must_use]
    pub fn with_patch(self, rows: usize, cols: usize) -> Self {
        Self { patch: Some((rows, cols)), ..self }
    }

    /// The same request with whole measurements in place of patches.
    #[must_use]
    pub fn of_whole_sensor(self) -> Self {
        Self { patch: None, ..self }
    }

    /// The same request with these numbers of training and test patches.
    #[must_use]
    pub fn with_patches(self, train: usize, test: usize) -> Self {
        Self { patches_train: train, patches_test: test, ..self }
    }

    /// The same request with this number of trials; the smallest estimate is reported.
    #[must_use]
    pub fn with_trials(self, trials: usize) -> Self {
        Self { trials, ..self }
    }

    /// The same request with fits that start from random weights in place of pretrained ones.
    #[must_use]
    pub fn from_random_weights(self) -> Self {
        Self { fresh: true, ..self }
    }

    /// Removes the checkpoint, once the result is stored at its destination.
    pub fn end_kept(&self) {
        if let Some(path) = &self.keep {
            checkpoint::end(path);
        }
    }

    /// Number of repetitions; the sources of a bracket's bounds are not repeated.
    pub(crate) fn repetitions(&self) -> usize {
        if matches!(self.model, DensityModel::Bracket { .. }) { 1 } else { self.trials.max(1) }
    }

    /// Most time left for the fits, where a time was requested, after the elapsed time and a share of all trials. Some of several trials
    /// may have been there before.
    pub(crate) fn time_left(&self, elapsed: Duration, share: f64) -> Option<Duration> {
        let FitLength::Time(time) = self.model.length()? else { return None };
        let repetitions = self.repetitions() as u32;
        let all = time.saturating_mul(repetitions);
        let by_clock = all.saturating_sub(elapsed);
        Some(if repetitions > 1 { by_clock.min(all.mul_f64((1.0 - share).max(0.0))) } else { by_clock })
    }

    /// Identity of the parts of an estimate, by fixed names. The number of trials is not part of it.
    pub(crate) fn identity(&self) -> Value {
        let Self { model, protocol, patch, patches_train, patches_test, fresh, weights, .. } = self;
        let path = |file: &Option<PathBuf>| file.as_deref().map(path_text);
        json!({
            "model": model.identity(),
            "protocol": match protocol {
                Protocol::Default => "default",
                Protocol::Paper => "paper",
            },
            "patch": patch.map(|(rows, cols)| [rows, cols]),
            "patches_train": patches_train,
            "patches_test": patches_test,
            "fresh": fresh,
            "weights": { "from": path(&weights.from), "to": path(&weights.to) },
        })
    }

    /// The texts for the same identity in earlier versions: see [`Identity::earlier`](kept_estimate::Identity::earlier).
    pub(crate) fn earlier_identities(&self) -> Vec<String> {
        let Self { model, protocol, patch, patches_train, patches_test, fresh, weights, .. } = self;
        let protocol = match protocol {
            Protocol::Default => "Default",
            Protocol::Paper => "Paper",
        };
        let text = |model: String| {
            let WeightsFiles { from, to } = weights;
            let weights = format!("WeightsFiles {{ from: {from:?}, to: {to:?} }}");
            format!("{model} {protocol} {patch:?} {patches_train} {patches_test} {fresh} {weights}")
        };
        model.earlier_names().into_iter().map(text).collect()
    }

    /// Initial weights of a causal model.
    pub(crate) fn init(&self) -> Init<'static> {
        if self.fresh { Init::Random } else { Init::Pretrained }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_that_is_left_is_that_of_all_trials() {
        let minutes = |minutes: u64| Duration::from_mins(minutes);
        let request = |estimator, trials| EstimateRequest::new(estimator).with_budget(minutes(10)).with_trials(trials);
        let left = |estimator, trials, elapsed, share| {
            request(estimator, trials).time_left(minutes(elapsed), share).map(|left| left.as_secs_f64() / 60.0)
        };
        assert_eq!(left(Estimator::Causal, 1, 4, 0.9), Some(6.0));
        assert_eq!(left(Estimator::Causal, 5, 10, 0.2), Some(40.0));
        // Four trials were there before.
        assert!((left(Estimator::Causal, 5, 1, 0.82).unwrap() - 9.0).abs() < 1e-6);
        // A bracket has one, of several parts.
        assert_eq!(left(Estimator::Bracket, 5, 4, 0.9), Some(6.0));
        assert_eq!(left(Estimator::GaussianFull, 5, 4, 0.9), None);
    }
}
