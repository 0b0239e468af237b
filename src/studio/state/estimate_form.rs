//! The forms of the Estimates panel.

use std::time::Duration;

use crate::information::{EngineChoice, Estimator, Protocol};
use crate::studio::widgets::file_preview::Preview;
use crate::workbench::{Calibration, DensityModel, EstimateRequest, WeightsFiles};

/// What the form asks for.
pub struct EstimateForm {
    pub kind: Estimator,
    pub length: FitLengthForm,
    pub whole_sensor: bool,
    /// Repetitions of a fit, of which the smallest counts; a bracket has one.
    pub trials: usize,
    /// How a PixelCNN is fitted and scored; the others know one way.
    pub protocol: Protocol,
    /// Images of a camera that may be estimated instead.
    pub camera: CameraForm,
    /// Index of the finished estimate whose curve is drawn; the newest where none was chosen.
    pub chosen: Option<usize>,
}

impl Default for EstimateForm {
    fn default() -> Self {
        let kind = Estimator::Bracket;
        let (length, camera) = (FitLengthForm::usual(kind), CameraForm::default());
        Self { kind, length, whole_sensor: false, trials: 1, protocol: Protocol::Default, camera, chosen: None }
    }
}

impl EstimateForm {
    /// Those that are fitted; the Gaussian bound follows every edit anyway.
    pub const KINDS: [(Estimator, &'static str, &'static str); 3] = [
        (
            Estimator::Bracket,
            "Bracket",
            "Lower bound by a decoder and AIS, upper bound by density model, Gaussian, object entropy and AIS",
        ),
        (Estimator::Full, "Full", "The density model of the live estimate, fitted for long"),
        (Estimator::PixelCnn, "PixelCNN", "The published density model"),
    ];

    pub fn request(&self, engine: EngineChoice) -> EstimateRequest {
        let request = self.request_of(self.length.model(self.kind, engine));
        match self.kind {
            Estimator::PixelCnn => EstimateRequest { trials: self.trials, protocol: self.protocol, ..request },
            Estimator::Full => EstimateRequest { trials: self.trials, ..request },
            _ => request,
        }
    }

    /// What is asked of a fit of this model, for the patch that was chosen.
    pub fn request_of(&self, model: DensityModel) -> EstimateRequest {
        EstimateRequest {
            model,
            protocol: Protocol::Default,
            patch: if self.whole_sensor { None } else { Some((32, 32)) },
            patches_train: 10_000,
            patches_test: 1_500,
            fresh: false,
            trials: 1,
            keep: None,
            weights: WeightsFiles::default(),
        }
    }
}

/// Images of a camera in place of a design's measurements.
pub struct CameraForm {
    /// The text of their path, once they were chosen.
    pub path: Option<String>,
    /// What is understood of them.
    pub preview: Preview,
    pub kind: Estimator,
    pub length: FitLengthForm,
    pub calibration: Calibration,
}

impl Default for CameraForm {
    fn default() -> Self {
        let kind = Estimator::Live;
        Self {
            path: None,
            preview: Preview::default(),
            kind,
            length: FitLengthForm::usual(kind),
            calibration: Calibration::default(),
        }
    }
}

impl CameraForm {
    /// Takes the images that a path names, with what is understood of them so far.
    pub fn choose(&mut self, path: String, preview: Preview) {
        self.path = Some(path);
        self.preview = preview;
    }
}

/// Estimators that need no objects.
pub const OF_IMAGES: [(Estimator, &str); 4] = [
    (Estimator::Live, "Live"),
    (Estimator::Full, "Full"),
    (Estimator::PixelCnn, "PixelCNN"),
    (Estimator::GaussianStationary, "Gaussian"),
];

/// The length of a fit, and how it is told.
pub struct FitLengthForm {
    pub minutes: f64,
    pub steps: usize,
    /// Whether a fit takes so many steps, or so much time.
    pub by_steps: bool,
}

impl FitLengthForm {
    /// What suits an estimator, in steps where it counts them.
    pub fn usual(kind: Estimator) -> Self {
        let minutes = kind.usual_budget().map_or(1.0, |budget| budget.as_secs_f64() / 60.0);
        // Steps that take about as long on two cores.
        let steps = if kind == Estimator::Full { 60_000 } else { 2_000 };
        Self { minutes, steps, by_steps: true }
    }

    /// The same for another estimator, told as this is.
    pub fn turn_to(&mut self, kind: Estimator) {
        *self = Self { by_steps: self.by_steps, ..Self::usual(kind) };
    }

    /// Whether the fit takes so many steps; that of the published model is ended by its protocol or by time.
    pub fn counts_steps(&self, kind: Estimator) -> bool {
        self.by_steps && kind != Estimator::PixelCnn
    }

    /// The model of a fit of this length.
    pub fn model(&self, kind: Estimator, engine: EngineChoice) -> DensityModel {
        let model = DensityModel::new(kind, Some(Duration::from_secs_f64(60.0 * self.minutes)), engine);
        if self.counts_steps(kind) { model.of_steps(self.steps) } else { model }
    }
}
