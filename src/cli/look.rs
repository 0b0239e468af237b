//! `look`: the numbers that the window shows beside every edit.

use std::ops::ControlFlow;

use clap::Args;
use serde::Serialize;

use super::choices::about_objects;
use super::design_args::{DesignArgs, SceneArgs};
use super::{Failure, output};
use crate::forward::{Design, notices_of};
use crate::information::{NamedBound, NoiseEntropy, Protocol, with_interval};
use crate::objects::Progress;
use crate::workbench::{EvaluationError, LiveInformation, Optics, Scene, SceneOptics, lower_bound_at_once};

/// Arguments of `look`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    design: DesignArgs,

    #[command(flatten)]
    scene: SceneArgs,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        let look = Look::bounded(&self.design.design(&self.scene)?)?;
        if self.json {
            return output::print_json(&look);
        }
        output::print(&look.lines().join("\n"))
    }
}

/// Bounds and Tamura coefficients of a design, as the window computes them for every edit.
#[derive(Debug, Serialize)]
pub struct Look {
    encoder: String,
    objects: String,
    objects_fingerprint: String,
    /// The objects, for people.
    scene: String,
    noise: String,
    seed: u64,
    /// None without noise.
    information: Option<Bounds>,
    /// Why there are none.
    no_information: Option<String>,
    sensor_tamura: f64,
    object_tamura: f64,
    notices: Vec<String>,
}

/// Bounds, bits per pixel.
#[derive(Debug, Serialize)]
struct Bounds {
    /// Rows and columns, pixels.
    patch: [usize; 2],
    /// None where it was not asked for, the prior of the objects is not known or nothing can be told; of other draws than in the
    /// window.
    lower: Option<NamedBound>,
    gaussian_bound: f64,
    /// Whether the Gaussian's number is a bound.
    gaussian_is_bound: bool,
    gaussian_interval_95: [f64; 2],
    entropy_y: f64,
    entropy_y_given_x: f64,
    ceiling: Option<f64>,
}

impl Bounds {
    fn of(information: &LiveInformation) -> Self {
        let gaussian = &information.gaussian;
        Self {
            patch: information.patch.into(),
            lower: None,
            gaussian_bound: gaussian.bits_per_pixel,
            gaussian_is_bound: information.gaussian_is_bound,
            gaussian_interval_95: information.interval_95,
            entropy_y: gaussian.entropy_y,
            entropy_y_given_x: gaussian.entropy_y_given_x,
            ceiling: information.ceiling_bits(),
        }
    }

    fn lines(&self) -> Vec<String> {
        let loose = self.ceiling.is_some_and(|ceiling| self.gaussian_bound > ceiling);
        let ([rows, cols], bound) = (self.patch, self.gaussian_bound);
        let gaussian = |bits| with_interval(bits, self.gaussian_interval_95);
        let mut lines = vec![format!("Information of a {rows} x {cols} px patch, bits per pixel:")];
        lines.extend(self.lower.as_ref().map(|lower| {
            format!(" at least {}  {}", with_interval(lower.bits_per_pixel, lower.interval_95), lower.from)
        }));
        let ceiling = match self.ceiling {
            Some(ceiling) => format!("  at most {ceiling:.3}                 object-entropy ceiling"),
            None => "  ceiling unknown: the entropy of these objects is not known".into(),
        };
        let gaussian = if self.gaussian_is_bound {
            format!("  at most {}  Gaussian bound", gaussian(bound))
        } else {
            format!("    about {}  Gaussian approximation", gaussian(bound))
        };
        lines.extend(if loose { [ceiling, gaussian] } else { [gaussian, ceiling] });
        lines.extend(loose.then(|| "  the Gaussian lies above the ceiling: do not rank designs by it".into()));
        lines
    }
}

/// Says what was understood of the files of the objects.
fn reading(progress: Progress) -> ControlFlow<()> {
    progress.understood.iter().for_each(output::tell);
    ControlFlow::Continue(())
}

impl Look {
    /// Opens the objects of a design and computes its numbers.
    pub fn at(design: &Design) -> anyhow::Result<Self> {
        let scene = Scene::open(design, &reading)?;
        Self::of(design, &scene).map_err(|error| about_objects(design, error))
    }

    /// The same with the lower bound that can be had in a moment.
    pub fn bounded(design: &Design) -> anyhow::Result<Self> {
        let scene = Scene::open(design, &reading)?;
        let mut look = Self::of(design, &scene).map_err(|error| about_objects(design, error))?;
        if let Some(bounds) = &mut look.information {
            // The others are told where this one cannot be had.
            bounds.lower = lower_bound_at_once(design, &scene.set, bounds.patch.into()).unwrap_or_default();
        }
        Ok(look)
    }

    fn of(design: &Design, scene: &Scene) -> Result<Self, EvaluationError> {
        let optics = Optics::of(design, scene.set.planes())?;
        let prepared = SceneOptics::new(scene, design.encoder.grid())?;
        let measurements = prepared.measure(design, &optics, scene)?;
        let information = NoiseEntropy::new(design.noise.bounding(), Protocol::Default)
            .map_err(EvaluationError::from)
            .and_then(|entropy| prepared.information(design, &optics, scene, &measurements, &entropy));
        let (information, no_information) = match information {
            Ok(information) => (Some(Bounds::of(&information)), None),
            // Without noise, say: the mask can be looked at all the same.
            Err(EvaluationError::Information(error)) => (None, Some(error.to_string())),
            Err(error) => return Err(error),
        };
        Ok(Self {
            encoder: design.encoder.describe(),
            objects: design.objects.to_string(),
            objects_fingerprint: scene.set.fingerprint(),
            scene: scene.set.describe(),
            noise: design.noise.to_string(),
            seed: design.seed,
            information,
            no_information,
            sensor_tamura: measurements.tamura.mean,
            object_tamura: scene.tamura.mean,
            notices: notices_of(design, &scene.set)?,
        })
    }

    /// The numbers for people, line by line.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![
            format!("{} before {}, {} noise", self.encoder, self.objects, self.noise),
            format!("  {}", self.scene),
        ];
        lines.extend(self.notices.iter().map(|notice| format!("  {notice}")));
        lines.extend(self.information.iter().flat_map(Bounds::lines));
        lines.extend(self.no_information.iter().map(|reason| format!("No information: {reason}")));
        lines.push(format!("Tamura coefficient: sensor {:.3}, objects {:.3}", self.sensor_tamura, self.object_tamura));
        lines
    }
}
