//! Comparison of systems by their captures.

use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::evaluation::{
    Compared, EqualLight, EstimateProgress, EstimateRequest, MeasuredConditions, SystemComparison,
};
use crate::plural::counted;
use crate::sensor::Noise;
use crate::workbench::background::activity::ActivityKind;
use crate::workbench::background::latest::{Order, Work};
use crate::workbench::cameras::comparison_file;
use crate::workbench::cameras::previews::SystemCaptures;

/// An order to estimate and compare systems.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ComparisonOrder {
    /// The captures.
    pub captures: Arc<SystemCaptures>,
    /// The estimates.
    pub request: EstimateRequest,
    /// Noise of the photons where no camera file states it.
    pub noise: Noise,
    /// Mean of equal light, photons per pixel; `None` compares the systems at their own light alone.
    pub equal_light: Option<f64>,
    /// Seed of all random draws.
    pub seed: u64,
    /// Whether frames of equal numbers show the same scene.
    pub is_simultaneous: bool,
}

/// A finished comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparisonResults {
    /// What was ordered.
    pub order: ComparisonOrder,
    /// The systems at their own light.
    pub own: Compared,
    /// The systems at equal light, if that was ordered.
    pub equal: Option<Compared>,
    /// Whether this version of the program would compute the same.
    pub is_of_this_version: bool,
}

/// An order whose results are stored, so that they outlive the window.
pub(crate) struct KeptComparison {
    pub(crate) order: ComparisonOrder,
    /// The file of the results; none where nothing is stored.
    pub(crate) file: Option<PathBuf>,
}

impl ComparisonOrder {
    fn compare(&self, light: Option<EqualLight>, work: &Work<'_, KeptComparison>) -> Result<Compared, String> {
        let SystemCaptures { sources, options } = &*self.captures;
        let noise = options.camera_noise().map_err(|error| error.to_string())?;
        // A camera without dark noise has shot noise.
        let noise = noise.unwrap_or(if options.camera.is_some() { Noise::Shot } else { self.noise });
        let comparison = SystemComparison {
            sources: sources.clone(),
            options: options.clone(),
            request: self.request.clone(),
            conditions: MeasuredConditions { noise, light, seed: self.seed },
            is_simultaneous: self.is_simultaneous,
        };
        let (place, lights) = match (light, self.equal_light) {
            (Some(_), _) => ("equal light", (1.0, 2.0)),
            (None, Some(_)) => ("own light", (0.0, 2.0)),
            (None, None) => ("own light", (0.0, 1.0)),
        };
        let mut on_progress = |progress: &EstimateProgress| {
            let share = (lights.0 + progress.done as f64 / progress.total.max(1) as f64) / lights.1;
            work.report(&format!("{} ({place})", progress.step), Some(share))
        };
        comparison.run(&mut on_progress).map_err(|error| error.to_string())
    }
}

impl Order for KeptComparison {
    type Results = Option<Arc<ComparisonResults>>;

    fn activity(&self) -> Option<(ActivityKind, String)> {
        let systems = counted(self.order.captures.sources.len(), "system");
        Some((ActivityKind::Comparison, format!("Compare {systems}")))
    }

    fn run(&self, work: &Work<'_, Self>) -> Result<(), String> {
        let order = &self.order;
        let own = order.compare(None, work)?;
        let light = order.equal_light.map(|mean_photons| EqualLight { mean_photons, ..EqualLight::default() });
        let equal = light.map(|light| order.compare(Some(light), work)).transpose()?;
        let results = Arc::new(ComparisonResults { order: order.clone(), own, equal, is_of_this_version: true });
        work.publish(|newest| *newest = Some(Arc::clone(&results)));
        let kept = self.file.as_ref().map_or(Ok(()), |file| comparison_file::write(file, &results));
        kept.map_err(|error| format!("the comparison is not stored: {error}"))
    }
}
