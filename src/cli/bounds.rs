//! `bounds`: bounds and Tamura coefficients, as the window shows them with every edit.

use std::ops::ControlFlow;

use clap::Args;
use serde::Serialize;

use super::choices::about_objects;
use super::design_args::{DesignArgs, SceneArgs};
use super::failure::Failure;
use super::output;
use crate::evaluation::{EvaluationError, LiveInformation, Optics, Scene, SceneTables, pretrained_lower_bound};
use crate::forward::{Design, notices_of};
use crate::information::{NamedBound, NoiseEntropy, Protocol, with_interval};
use crate::objects::ReadProgress;

/// Arguments of `bounds`.
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
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        let bounds = DesignBounds::with_lower_bound(&self.design.design(&self.scene)?)?;
        if self.json {
            return output::print_json(&bounds);
        }
        output::print(&bounds.lines().join("\n"))
    }
}

/// Bounds and Tamura coefficients of a design.
#[derive(Debug, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct DesignBounds {
    /// Description of the mask.
    encoder: String,
    /// Throughput of the mask.
    throughput: f64,
    /// The objects, by the text of their source.
    objects: String,
    /// Fingerprint of the objects.
    objects_fingerprint: String,
    /// Description of the objects.
    scene: String,
    /// Noise of the sensor.
    noise: String,
    /// Seed of objects and noise.
    seed: u64,
    /// Bounds, bits per pixel; none without noise.
    information: Option<Information>,
    /// Reason why there are no bounds.
    no_information: Option<String>,
    /// Mean Tamura coefficient of the measurements.
    sensor_tamura: f64,
    /// Mean Tamura coefficient of the objects.
    object_tamura: f64,
    /// Notices on the objects.
    notices: Vec<String>,
}

/// Bounds, bits per pixel.
#[derive(Debug, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct Information {
    /// Rows and columns of the patch, pixels.
    patch: [usize; 2],
    /// Lower bound of the pretrained decoder; none without a known prior. The window uses other random draws.
    lower: Option<NamedBound>,
    /// Upper bound of the Gaussian of the same mean and covariance.
    gaussian_bound: f64,
    /// Whether the Gaussian number is an upper bound (in place of an approximation).
    gaussian_is_bound: bool,
    /// Its 95 % interval.
    gaussian_interval_95: [f64; 2],
    /// Entropy of the measurements under this Gaussian.
    entropy_y: f64,
    /// Entropy of the noise.
    entropy_y_given_x: f64,
    /// Object-entropy bound; none where the entropy of the objects is unknown.
    ceiling: Option<f64>,
}

impl Information {
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
            Some(ceiling) => format!("  at most {ceiling:.3}                 object-entropy bound"),
            None => "  no object-entropy bound: the entropy of these objects is unknown".into(),
        };
        let gaussian = if self.gaussian_is_bound {
            format!("  at most {}  Gaussian bound", gaussian(bound))
        } else {
            format!("    about {}  Gaussian approximation", gaussian(bound))
        };
        lines.extend(if loose { [ceiling, gaussian] } else { [gaussian, ceiling] });
        lines.extend(
            loose.then(|| "  The Gaussian bound exceeds the object-entropy bound: do not rank designs by it".into()),
        );
        lines
    }
}

/// Reports how the files of the objects were interpreted.
fn reading(progress: &ReadProgress) -> ControlFlow<()> {
    progress.understood.iter().for_each(output::report);
    ControlFlow::Continue(())
}

impl DesignBounds {
    /// Opens the objects of a design and computes its upper bounds and Tamura coefficients.
    pub fn open(design: &Design) -> anyhow::Result<Self> {
        let scene = Scene::open(design, &mut reading)?;
        Self::of(design, &scene).map_err(|error| about_objects(design, error))
    }

    /// The same with the lower bound of the pretrained decoder.
    pub fn with_lower_bound(design: &Design) -> anyhow::Result<Self> {
        let scene = Scene::open(design, &mut reading)?;
        let mut bounds = Self::of(design, &scene).map_err(|error| about_objects(design, error))?;
        if let Some(information) = &mut bounds.information {
            // Without a lower bound the other numbers are printed.
            information.lower =
                pretrained_lower_bound(design, &scene.set, information.patch.into()).unwrap_or_default();
        }
        Ok(bounds)
    }

    fn of(design: &Design, scene: &Scene) -> Result<Self, EvaluationError> {
        let optics = Optics::of(design, scene.set.planes())?;
        let prepared = SceneTables::new(scene, design.encoder.grid())?;
        let measurements = prepared.measure(design, &optics, scene)?;
        let information = NoiseEntropy::new(design.noise.bounding(), Protocol::Default)
            .map_err(EvaluationError::from)
            .and_then(|entropy| prepared.information(design, &optics, scene, &measurements, &entropy));
        let (information, no_information) = match information {
            Ok(information) => (Some(Information::of(&information)), None),
            // Without noise, for example: the Tamura coefficients exist all the same.
            Err(EvaluationError::Information(error)) => (None, Some(error.to_string())),
            Err(error) => return Err(error),
        };
        Ok(Self {
            encoder: design.encoder.describe(),
            throughput: design.encoder.throughput(),
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

    /// Text of the numbers, line by line.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![
            format!("{} imaging {}, {} noise", self.encoder, self.objects, self.noise),
            format!("  {}", self.scene),
        ];
        lines.extend(self.notices.iter().map(|notice| format!("  {notice}")));
        lines.extend(self.information.iter().flat_map(Information::lines));
        lines.extend(self.no_information.iter().map(|reason| format!("No information: {reason}")));
        lines.push(format!("Tamura coefficient: sensor {:.3}, objects {:.3}", self.sensor_tamura, self.object_tamura));
        lines
    }
}
