//! State of the Estimates panel: its forms and the chosen estimate.

use std::time::Duration;

use crate::evaluation::{DensityModel, EstimateRequest};
use crate::information::{EngineChoice, Estimator, Protocol};

/// State of the Estimates panel.
pub struct EstimatesState {
    /// The estimator.
    pub kind: Estimator,
    /// Length of the fit.
    pub length: FitLengthForm,
    /// Whether whole measurements are estimated in place of patches.
    pub whole_sensor: bool,
    /// Number of fits. The smallest value counts; a bracket has one fit.
    pub trials: usize,
    /// Protocol of a PixelCNN; other estimators have one.
    pub protocol: Protocol,
    /// Index of the finished estimate whose curve is drawn; the newest if none was chosen.
    pub chosen: Option<usize>,
}

impl Default for EstimatesState {
    fn default() -> Self {
        let kind = Estimator::Bracket;
        let length = FitLengthForm::usual(kind);
        Self { kind, length, whole_sensor: false, trials: 1, protocol: Protocol::Default, chosen: None }
    }
}

impl EstimatesState {
    /// Estimators that are fitted, with label and tooltip. The Gaussian bound is computed after every edit anyway.
    pub const KINDS: [(Estimator, &'static str, &'static str); 3] = [
        (
            Estimator::Bracket,
            "Bracket",
            "Lower bound by a decoder and AIS, upper bound by density model, Gaussian, object entropy and AIS",
        ),
        (Estimator::Causal, "Causal model", "The density model of the live estimate, with a budget of its own"),
        (Estimator::PixelCnn, "PixelCNN", "The published density model"),
    ];

    /// Request of the form.
    pub fn request(&self, engine: EngineChoice) -> EstimateRequest {
        let request = EstimateRequest {
            model: self.length.model(self.kind, engine),
            patch: if self.whole_sensor { None } else { Some((32, 32)) },
            ..EstimateRequest::default()
        };
        match self.kind {
            Estimator::PixelCnn => EstimateRequest { trials: self.trials, protocol: self.protocol, ..request },
            Estimator::Causal => EstimateRequest { trials: self.trials, ..request },
            _ => request,
        }
    }
}

/// Length of a fit, as a number of steps or a time.
pub struct FitLengthForm {
    /// Length as a time.
    pub minutes: f64,
    /// Length as a number of steps.
    pub steps: usize,
    /// Whether the length is a number of steps.
    pub by_steps: bool,
}

impl FitLengthForm {
    /// Default length for an estimator.
    pub fn usual(kind: Estimator) -> Self {
        let minutes = kind.default_budget().map_or(1.0, |budget| budget.as_secs_f64() / 60.0);
        let steps = 2_000;
        Self { minutes, steps, by_steps: true }
    }

    /// Switches to another estimator and its default length.
    pub fn turn_to(&mut self, kind: Estimator) {
        *self = Self { by_steps: self.by_steps, ..Self::usual(kind) };
    }

    /// Whether the length is a number of steps; a PixelCNN ends by its protocol or by time.
    pub fn counts_steps(&self, kind: Estimator) -> bool {
        self.by_steps && kind != Estimator::PixelCnn
    }

    /// Density model with this length as its budget.
    pub fn model(&self, kind: Estimator, engine: EngineChoice) -> DensityModel {
        let model = DensityModel::new(kind, Some(Duration::from_secs_f64(60.0 * self.minutes)), engine);
        if self.counts_steps(kind) { model.of_steps(self.steps) } else { model }
    }
}
