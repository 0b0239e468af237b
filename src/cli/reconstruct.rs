//! `reconstruct`: objects from simulated measurements with their image quality, or from a real capture.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use clap::Args;
use ndarray::{Array3, Array4, Axis};
use serde::Serialize;

use super::choices::{about_objects, check_count, names_of};
use super::design_args::{DesignArgs, SceneArgs, check_inputs_stay};
use super::failure::Failure;
use super::output;
use super::output::ProgressLine;
use super::reconstruct_folder::OutFolder;
use super::reconstruct_network::{NetworkArgs, NetworkResult, settings_key};
use super::stop::{StopSignal, is_stopped};
use crate::formats::remove_if_there;
use crate::forward::{Design, ForwardModel, notices_of};
use crate::information::{PosteriorChains, Protocol, with_interval};
use crate::progress::CancelToken;
use crate::reconstruction::{
    Capture, CaptureChannel, CaptureFiles, DarkLevel, Decoder, DecoderKind, DecoderQuality, DecoderScene, DecoderTest,
    Evaluated, ImagingModel, ReconstructionStep, SavingDecoder, TrainedDecoder, residual_in_noise,
};
use crate::workbench::{RECONSTRUCTIONS_FILE, ReconstructionExample, ReconstructionWriter};

/// Fewest test objects, as one has no interval, and most.
const TEST_OBJECTS: std::ops::RangeInclusive<usize> = 2..=1_000_000;
/// Sweeps of Markov chains.
const SWEEPS: std::ops::RangeInclusive<usize> = 1..=1_000_000;
/// Examples where their number is not given, and most.
const EXAMPLES: usize = 4;
const MOST_EXAMPLES: usize = 1000;
/// Largest side of squares that are averaged, px.
const LARGEST_BIN: usize = 64;

/// Arguments of `reconstruct`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    design: DesignArgs,

    #[command(flatten)]
    scene: SceneArgs,

    /// Decoder [default: linear; of a capture tv].
    #[arg(long, value_enum)]
    decoder: Option<DecoderKind>,

    /// default: the scene as it is; paper: each object alone scaled to 100 photons per pixel, no background, shot noise.
    #[arg(long, default_value_t = Protocol::Default, conflicts_with = "measurement")]
    protocol: Protocol,

    /// Test objects, made of images that no prior was learned from.
    #[arg(long, default_value_t = 500, conflicts_with = "measurement")]
    test: usize,

    /// Folder for reconstructions.npy, images and networks; created if missing. Without it nothing is saved.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Markov chains of this many sweeps for each image refine the posterior mean; without, it is that of the trained decoder.
    #[arg(long, value_name = "N", conflicts_with = "measurement")]
    sweeps: Option<usize>,

    /// Test objects that are also written into --out as images: truth, measurement, reconstruction, error [default: 4].
    #[arg(long, value_name = "N", conflicts_with = "measurement")]
    examples: Option<usize>,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    capture: CaptureArgs,

    #[command(flatten)]
    network: NetworkArgs,
}

/// A real capture in place of a design.
#[derive(Args, Debug)]
#[command(next_help_heading = "Capture of a camera")]
struct CaptureArgs {
    /// Capture in place of a design: NPY, NPZ, TIFF, PNG or JPEG, grey or colour. FILE?channel=green takes one channel.
    #[arg(
        long, value_name = "FILE", requires = "psf",
        conflicts_with_all = ["design", "mask", "seed", "objects", "mean_photons", "bias", "noise"]
    )]
    measurement: Option<PathBuf>,

    /// Photograph of the point spread function of that camera, no larger than the capture.
    #[arg(long, value_name = "FILE", requires = "measurement")]
    psf: Option<PathBuf>,

    /// Grey value (DN) without light, or a capture without light [default: the corners of the PSF].
    #[arg(long, value_name = "DN or FILE", requires = "measurement", allow_negative_numbers = true)]
    dark: Option<DarkLevel>,

    /// Average squares of this side, of capture and PSF alike.
    #[arg(long, value_name = "PIXELS", default_value_t = 1, requires = "measurement")]
    bin: usize,
}

/// Result for a design.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct TestResult {
    /// Description of the mask.
    encoder: String,
    /// The objects as on the command line.
    objects: String,
    /// Fingerprint of the objects.
    objects_fingerprint: String,
    /// Noise of the measurements.
    noise: String,
    #[serde(flatten)]
    quality: DecoderQuality,
    /// Networks that were trained or read; absent for other decoders.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    trained: Vec<NetworkResult>,
    /// What is odd about the result.
    notices: Vec<String>,
    /// Written files.
    files: Vec<String>,
}

/// Result for a capture.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct CaptureResult {
    /// The decoder.
    decoder: DecoderKind,
    /// File of the capture.
    measurement: String,
    /// File of the photograph of the PSF.
    psf: String,
    /// Frames, rows and columns after binning.
    measurement_shape: [usize; 3],
    /// Frames, rows and columns of the objects, and channels where there are several.
    object_shape: Vec<usize>,
    /// First row and column of the part of the object that lies before the sensor.
    sensor_corner: [usize; 2],
    /// Estimated DN per photon of each channel.
    gain: Vec<f64>,
    /// Estimated read noise of each channel, photons.
    read_noise: Vec<f64>,
    /// Root mean square of the residual of each channel, in units of the estimated noise.
    residual: Vec<f64>,
    /// Seconds of reading and reconstruction.
    seconds: f64,
    /// How the files were read, and what was changed.
    notices: Vec<String>,
    /// Written files.
    files: Vec<String>,
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        let stop = StopSignal::listen_if(self.out.is_some());
        let result = match &self.capture.measurement {
            Some(measurement) => self.reconstruct_capture(measurement.clone(), &stop),
            None => self.test_design(&stop),
        };
        match (result, &self.out) {
            (Err(Failure::Input(error)), Some(out)) if is_stopped(&error) => {
                // The scheduler or a person asked to stop. Trained networks and slow estimates are kept.
                let resumes = self.keeps_state();
                let outcome = if resumes { "the same command resumes it" } else { "nothing was saved" };
                output::report(format_args!("{}: stopped; {outcome}", out.display()));
                if !resumes {
                    stop.end_program();
                }
                Ok(())
            }
            (result, _) => result,
        }
    }

    /// Whether the same command resumes a stopped test: of networks that are trained, and of slow estimates. Both are in the folder.
    fn keeps_state(&self) -> bool {
        let kind = self.decoder.unwrap_or_default();
        let is_test = self.out.is_some() && self.capture.measurement.is_none();
        is_test && (self.network.trains(kind) || self.is_slow(kind))
    }

    /// Whether estimates take longer than writing them.
    fn is_slow(&self, kind: DecoderKind) -> bool {
        self.sweeps.is_some() || !(kind.needs().objects || kind.needs().training)
    }

    /// Refuses numbers that are out of range, and flags that do not fit each other.
    fn check(&self, kind: DecoderKind) -> anyhow::Result<()> {
        check_count("--test", self.test, TEST_OBJECTS)?;
        self.sweeps.map_or(Ok(()), |sweeps| check_count("--sweeps", sweeps, SWEEPS))?;
        if let Some(examples) = self.examples {
            check_count("--examples", examples, 0..=MOST_EXAMPLES)?;
            if self.out.is_none() {
                anyhow::bail!("--examples: expected a folder for the images, found none; add --out DIR");
            }
        }
        self.network.check(kind)?;
        if self.sweeps.is_some() && kind != DecoderKind::Posterior {
            anyhow::bail!("--sweeps: expected --decoder posterior, found {kind}; leave --sweeps out");
        }
        Ok(())
    }

    fn test_design(&self, stop: &StopSignal) -> Result<(), Failure> {
        let kind = self.decoder.unwrap_or_default();
        self.check(kind)?;
        let design = self.design.design(&self.scene)?;
        let mut folder = self.out.as_deref().map(OutFolder::open).transpose()?;
        if let Some(out) = &self.out {
            self.design.check_inputs_stay(&[out.join(RECONSTRUCTIONS_FILE)], &design)?;
            check_inputs_stay(&self.network.inputs(), &[out.join(RECONSTRUCTIONS_FILE)], ("--out", None))?;
        }
        let forward = ForwardModel::open(&design).map_err(|error| about_objects(&design, error.into()))?;
        if let Some(understood) = forward.set.understood() {
            output::report(format_args!("{}: {understood}", design.objects));
        }
        let scene = DecoderScene::new(&forward, self.protocol)?;
        let psf = forward.psf(&design)?;
        let model = scene.model(psf.view())?.of_mask(&design.encoder);
        let trained = if kind.needs().training {
            Some(self.network.networks(kind, (&scene, &model), &design, (self.out.as_deref(), stop))?)
        } else {
            None
        };
        let progress_line = ProgressLine::new();
        progress_line.show(0, self.test, "Learning the prior");
        let prior = kind.needs().objects.then(|| scene.prior(&CancelToken::new())).transpose()?.map(Arc::new);
        let chains = self.sweeps.map(|sweeps| PosteriorChains::of_sweeps(sweeps, design.seed));
        let estimates = self.estimates_file(kind, &scene, &design);
        let decoders: Vec<Box<dyn Decoder>> = match &trained {
            Some(trained) => {
                let decoder = |network: &TrainedDecoder| network.decoder(&scene, prior.as_ref());
                trained.networks.iter().map(decoder).collect::<Result<_, _>>()?
            }
            None => vec![saving(kind.decoder(prior, chains)?, estimates.clone())],
        };
        let (rows, cols) = scene.set.field();
        let shape = [self.test, rows, cols];
        let examples = self.examples.unwrap_or(EXAMPLES);
        // The writer has a lock of its own.
        folder.iter_mut().for_each(OutFolder::unlock);
        let mut writer = self.out.as_ref().map(|out| ReconstructionWriter::create(out, &shape)).transpose()?;
        let mut write = |part: &Evaluated<'_>| {
            let Some(writer) = &mut writer else { return Ok(()) };
            writer.append(part.reconstructions.into_dyn())?;
            for index in 0..part.quality.len().min(examples.saturating_sub(part.first)) {
                let example = ReconstructionExample {
                    truth: part.test.objects.index_axis(Axis(0), index),
                    measurement: part.test.measurements.index_axis(Axis(0), index),
                    reconstruction: part.reconstructions.index_axis(Axis(0), index),
                };
                writer.example(part.first + index + 1, example)?;
            }
            Ok(())
        };
        let test = DecoderTest { objects: self.test, seed: design.seed };
        let mut on_progress = |step: &ReconstructionStep| show(&progress_line, step, stop);
        let mut all = Vec::new();
        for (index, decoder) in decoders.iter().enumerate() {
            // The files hold what the first network makes.
            let mut receive = |part: &Evaluated<'_>| if index == 0 { write(part) } else { Ok(()) };
            all.push(test.run::<anyhow::Error>(&**decoder, &scene, &model, &mut on_progress, &mut receive)?);
        }
        let quality = match &trained {
            Some(_) => DecoderQuality::over_networks(&all)?,
            None => all.pop(),
        };
        let quality = quality.ok_or_else(|| anyhow::anyhow!("no decoder was tested"))?;
        progress_line.finish();
        let mut files = writer.map(ReconstructionWriter::finish).transpose()?.unwrap_or_default();
        if let Some((file, _)) = estimates {
            remove_if_there(&file).map_err(anyhow::Error::from)?;
        }
        files.extend(trained.iter().flat_map(|trained| trained.files.clone()));
        let networks = trained.iter().flat_map(|trained| &trained.networks);
        let mut notices = notices_of(&design, &scene.set)?;
        notices.extend(scene.notices(&quality));
        let result = TestResult {
            trained: networks.map(NetworkResult::from).collect(),
            encoder: design.encoder.describe(),
            objects: design.objects.to_string(),
            objects_fingerprint: scene.set.fingerprint(),
            noise: scene.noise.to_string(),
            quality,
            notices,
            files: names_of(&files),
        };
        if self.json {
            return output::print_json(&result);
        }
        for notice in &result.notices {
            output::report(notice);
        }
        output::print(&result.lines().join("\n"))
    }

    /// File of the estimates of a decoder and the key of its settings, where estimates take longer than writing them.
    fn estimates_file(&self, kind: DecoderKind, scene: &DecoderScene, design: &Design) -> Option<(PathBuf, String)> {
        let out = self.out.as_ref().filter(|_| self.is_slow(kind))?;
        let settings = settings_key(kind, (scene, design), [("sweeps", self.sweeps.into())]);
        let name = settings.get(..8).unwrap_or_default();
        Some((out.join(format!("estimates-{name}.state")), settings))
    }

    fn reconstruct_capture(&self, measurement: PathBuf, stop: &StopSignal) -> Result<(), Failure> {
        check_count("--bin", self.capture.bin, 1..=LARGEST_BIN)?;
        // The flag is required with --measurement.
        let psf = self.capture.psf.clone().unwrap_or_default();
        let kind = self.decoder.unwrap_or(DecoderKind::TotalVariation);
        if kind.needs().training || kind.needs().objects {
            return Err(anyhow::anyhow!(
                "--decoder: expected one for a capture alone, found {kind}, which needs objects; choose tv or richardson-lucy"
            )
            .into());
        }
        let decoder = kind.decoder(None, None)?;
        let files = CaptureFiles { measurement, psf, dark: self.capture.dark.clone(), bin: self.capture.bin };
        let mut folder = self.out.as_deref().map(OutFolder::open).transpose()?;
        if let Some(out) = &self.out {
            let mut inputs = vec![files.measurement.clone(), files.psf.clone()];
            if let Some(DarkLevel::File(dark)) = &files.dark {
                inputs.push(dark.clone());
            }
            check_inputs_stay(&inputs, &[out.join(RECONSTRUCTIONS_FILE)], ("--out", None))?;
        }
        let started = Instant::now();
        let Capture { channels, notices } = files.open()?;
        notices.iter().for_each(output::report);
        if self.out.is_none() {
            output::report("the reconstruction is in no file: add --out DIR to keep it");
        }
        let progress_line = ProgressLine::new();
        let (mut objects, mut residual) = (Vec::new(), Vec::new());
        let mut corner = (0, 0);
        for channel in &channels {
            let CaptureChannel { measurements, psf, noise, .. } = channel;
            let model = ImagingModel::of_capture(psf.view(), shape_of(measurements), *noise)?;
            corner = model.sensor_corner();
            let prepared = decoder.prepare(&model, &CancelToken::new())?;
            let mut on_progress = |step: &ReconstructionStep| show(&progress_line, step, stop);
            let found = prepared.reconstruct(measurements.view(), &mut on_progress)?;
            residual.push(residual_in_noise(&model, found.view(), measurements.view())?);
            objects.push(channel.grey_values(found.view()));
        }
        progress_line.finish();
        let seconds = started.elapsed().as_secs_f64();
        let objects = with_channels(&objects);
        let measured: Vec<Array3<f32>> =
            channels.iter().map(|channel| channel.grey_values(channel.measurements.view())).collect();
        let measured = with_channels(&measured);
        let mut object_shape = objects.shape().to_vec();
        if channels.len() == 1 {
            object_shape.pop();
        }
        let mut written = Vec::new();
        if let Some(out) = &self.out {
            folder.iter_mut().for_each(OutFolder::unlock);
            let mut writer = ReconstructionWriter::create(out, &object_shape)?;
            writer.append(objects.view().into_dyn())?;
            for (frame, (object, measured)) in objects.outer_iter().zip(measured.outer_iter()).enumerate() {
                writer.frame(frame + 1, object, measured)?;
            }
            written = writer.finish()?;
        }
        let (frames, rows, cols, _) = measured.dim();
        let result = CaptureResult {
            decoder: kind,
            measurement: files.measurement.display().to_string(),
            psf: files.psf.display().to_string(),
            measurement_shape: [frames, rows, cols],
            object_shape,
            sensor_corner: corner.into(),
            gain: channels.iter().map(|channel| channel.gain).collect(),
            read_noise: channels.iter().filter_map(|channel| channel.noise.read_sigma()).collect(),
            residual,
            seconds,
            notices,
            files: names_of(&written),
        };
        if self.json {
            return output::print_json(&result);
        }
        output::print(&result.lines().join("\n"))
    }
}

/// A decoder that saves its estimates, where there is a file with the key of its settings.
fn saving(decoder: Box<dyn Decoder>, estimates: Option<(PathBuf, String)>) -> Box<dyn Decoder> {
    match estimates {
        Some((file, settings)) => Box::new(SavingDecoder::new(decoder, file, settings)),
        None => decoder,
    }
}

/// Shows the progress of a reconstruction; `Break` once a signal asks to stop.
fn show(line: &ProgressLine, step: &ReconstructionStep, stop: &StopSignal) -> ControlFlow<()> {
    match step {
        ReconstructionStep::Images { done, total } => line.show(*done, *total, "Reconstructing"),
        ReconstructionStep::Iteration { done, most, .. } => line.show(*done, *most, "Iterating"),
    }
    stop.check()
}

/// Rows and columns of a stack.
fn shape_of(stack: &Array3<f32>) -> (usize, usize) {
    (stack.len_of(Axis(1)), stack.len_of(Axis(2)))
}

/// Channels of shape (n, rows, cols) as one array of shape (n, rows, cols, channels).
fn with_channels(channels: &[Array3<f32>]) -> Array4<f32> {
    let (count, rows, cols) = channels.first().map_or((0, 0, 0), Array3::dim);
    Array4::from_shape_fn((count, rows, cols, channels.len()), |(n, row, col, channel)| {
        channels[channel][(n, row, col)]
    })
}

impl TestResult {
    fn lines(&self) -> Vec<String> {
        let quality = &self.quality;
        let number =
            |name: &str, value: f64, interval: [f64; 2]| format!("{name:<7}{}", with_interval(value, interval));
        let mut lines = vec![
            format!("{}: {} imaging {}, {} protocol", quality.decoder, self.encoder, self.objects, quality.protocol),
            number("PSNR", quality.psnr_db, quality.psnr_db_interval_95) + " dB",
        ];
        let constant = with_interval(quality.psnr_constant_db, quality.psnr_constant_db_interval_95);
        lines.push(format!("       {constant} dB for the mean object"));
        if let Some(expected) = quality.psnr_posterior_db {
            let sample = with_interval(quality.psnr_unclipped_db, quality.psnr_unclipped_db_interval_95);
            lines.push(format!("       {sample} dB not clipped; the posterior expects {expected:.3} dB"));
        }
        if let Some(closed_form) = quality.psnr_linear_closed_form_db {
            let sample = with_interval(quality.psnr_unclipped_db, quality.psnr_unclipped_db_interval_95);
            lines.push(format!("       {sample} dB not clipped; in closed form {closed_form:.3} dB"));
        }
        lines.push(number("SSIM", quality.ssim, quality.ssim_interval_95));
        let [low, high] = quality.mse_interval_95;
        lines.push(format!("{:<7}{:.3e} [{low:.3e}, {high:.3e}]", "MSE", quality.mse));
        if let (Some(r2), Some(interval)) = (quality.r2, quality.r2_interval_95) {
            lines.push(number("R2", r2, interval));
        }
        lines.push(format!("{} test objects, seed {}, {:.1} s", quality.test_objects, quality.seed, quality.seconds));
        lines.extend(self.files.iter().cloned());
        lines
    }
}

impl CaptureResult {
    fn lines(&self) -> Vec<String> {
        let text = |shape: &[usize]| shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(" x ");
        let mut lines = vec![
            format!("{} of {}: {}", self.decoder, self.measurement, text(&self.object_shape)),
            format!(
                "capture of {}, {:.1} s; residual {} times the noise",
                text(&self.measurement_shape),
                self.seconds,
                self.residual.iter().map(|residual| format!("{residual:.2}")).collect::<Vec<_>>().join(", ")
            ),
        ];
        lines.extend(self.files.iter().cloned());
        lines
    }
}
