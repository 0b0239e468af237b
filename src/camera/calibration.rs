//! Calibration of a camera from a photon transfer series, after EMVA 1288 release 4.0.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::channel::ColourChoice;
use super::error::CameraError;
use super::frames::{BlockSums, FrameReader, FrameStack};
use super::nonuniformity::{Outliers, is_shaded, outliers, spatial_variance};
use super::notes::{Copies, frame_notes};
use super::response::{linearity, quantum_efficiency};
use super::series::{FrameGroup, FrameSeries};
use super::transfer::{LightLevel, PhotonTransfer, ROUNDING_VARIANCE, Step, TransferSeries};
use crate::formats::Wrapped;
use crate::plural::{counted, one_or_many};
use crate::progress::Progress;

/// Frames of a group from which nonuniformity is computed.
const SPATIAL_FRAMES: usize = 3;
/// Light level of the photo response nonuniformity, as a share of saturation (EMVA 1288), and the range that is accepted.
const PRNU_SHARE: f64 = 0.5;
const PRNU_RANGE: std::ops::RangeInclusive<f64> = 0.1..=0.9;
/// Largest spread of the means of the frames of one light level, as a share of its signal.
const MOST_FLICKER: f64 = 0.05;
/// Most pixels that are listed one by one.
const MOST_LISTED: usize = 1000;
/// Largest share of dark values that may look wrapped, as hot pixels do.
const MOST_WRAPPED: f64 = 1e-3;
/// Side of the blocks whose means are shading.
const SHADING_PX: usize = 8;

/// One step of a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationProgress {
    /// Name of the group that is read.
    pub group: String,
    /// Groups read so far.
    pub done: usize,
    /// Groups to read.
    pub total: usize,
}

/// Pixels that stand out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct PixelList {
    /// Number of pixels.
    pub count: usize,
    /// Row and column of each, at most 1000.
    pub places: Vec<[usize; 2]>,
}

impl PixelList {
    fn of(pixels: &[usize], cols: usize) -> Self {
        let places = pixels.iter().take(MOST_LISTED).map(|pixel| [pixel / cols, pixel % cols]).collect();
        Self { count: pixels.len(), places }
    }
}

/// Quantities of a camera by their names in EMVA 1288. Grey values are DN.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct CameraCalibration {
    /// System gain K, DN per electron.
    pub system_gain_dn_per_electron: f64,
    /// Its 95 % interval (low, high), by a bootstrap over blocks of pixels.
    pub system_gain_dn_per_electron_interval_95: [f64; 2],
    /// Mean grey value of the dark frames of the shortest exposure, DN.
    pub dark_signal_dn: f64,
    /// Its 95 % interval.
    pub dark_signal_dn_interval_95: [f64; 2],
    /// Temporal standard deviation in the dark, with its rounding, DN.
    pub temporal_dark_noise_dn: f64,
    /// Its 95 % interval.
    pub temporal_dark_noise_dn_interval_95: [f64; 2],
    /// Temporal dark noise without rounding, electrons.
    pub temporal_dark_noise_electrons: f64,
    /// Its 95 % interval.
    pub temporal_dark_noise_electrons_interval_95: [f64; 2],
    /// Mean grey value at saturation, DN.
    pub saturation_dn: f64,
    /// Saturation capacity, electrons.
    pub saturation_electrons: f64,
    /// Largest signal-to-noise ratio, that at saturation, dB.
    pub snr_max_db: f64,
    /// Saturation capacity over the signal of SNR 1, dB.
    pub dynamic_range_db: f64,
    /// Mean deviation from a line between 5 and 95 % of saturation, per cent, or null where exposures are unknown.
    pub linearity_error_percent: Option<f64>,
    /// Standard deviation of the dark signal over pixels, electrons, or null without three dark frames of one exposure.
    pub dsnu_electrons: Option<f64>,
    /// Standard deviation of the response over pixels, per cent, or null without three frames near half of saturation.
    pub prnu_percent: Option<f64>,
    /// Electrons per photon, or null where photons are unknown.
    pub quantum_efficiency: Option<f64>,
    /// Pixels of a dark signal or response far above that of their neighbours.
    pub hot_pixels: PixelList,
    /// Pixels of a dark signal or response far below that of their neighbours.
    pub dim_pixels: PixelList,
    /// Rows of a frame, pixels.
    pub rows: usize,
    /// Columns of a frame, pixels.
    pub cols: usize,
    /// Smallest distance of grey values, DN; 0 where they are not whole.
    pub grey_value_step_dn: f64,
    /// The colour that was taken from the frames, or null for grey frames.
    pub colour: Option<String>,
    /// The photon transfer curve, by rising light.
    pub light_levels: Vec<LightLevel>,
    /// Sentences for the reader.
    pub notes: Vec<String>,
}

/// Maps of the pixels of a camera, shape (rows, cols).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraMaps {
    /// Dark signal of each pixel, DN; `None` where its differences lie below the noise of the mean frame.
    pub dark_signal_dn: Option<Array2<f32>>,
    /// Response of each pixel over the mean response; `None` where its differences lie below the noise of the mean frame.
    pub response: Option<Array2<f32>>,
    /// 0 for a good pixel, 1 for a hot and 2 for a dim one.
    pub mask: Array2<f32>,
}

/// A calibration with the maps of its pixels.
#[derive(Clone, Debug)]
pub struct CalibratedCamera {
    /// The quantities.
    pub calibration: CameraCalibration,
    /// The maps.
    pub maps: CameraMaps,
}

/// Groups of a series, read one after the other.
struct Reading<'a> {
    reader: FrameReader<'a>,
    progress: &'a mut dyn Progress<CalibrationProgress>,
    done: usize,
    total: usize,
}

impl Reading<'_> {
    fn read(&mut self, group: &FrameGroup) -> Result<FrameStack, CameraError> {
        let step = CalibrationProgress { group: group.label.clone(), done: self.done, total: self.total };
        if self.progress.report(&step).is_break() {
            return Err(CameraError::Cancelled);
        }
        self.done += 1;
        self.reader.read(group)
    }
}

fn step_of(group: &FrameGroup, stack: &FrameStack, counts: &[bool]) -> Step {
    Step {
        label: group.label.clone(),
        exposure_ns: group.exposure_ns,
        photons: group.photons,
        frames: stack.frames,
        cut_off_share: stack.cut_off_share,
        pixels: counts.iter().filter(|counts| **counts).count() as f64,
        sums: BlockSums::of(stack, counts),
    }
}

/// Calibrates a camera from its series of frames.
///
/// Hot pixels are found in the dark frames and left out of all means and variances.
///
/// # Errors
/// [`CameraError`] for frames that cannot be read, differ in size or depth, or come alone; for light without shot noise, and dark frames
/// that are brighter than light.
pub fn calibrate(
    series: &FrameSeries,
    colour: ColourChoice,
    progress: &mut dyn Progress<CalibrationProgress>,
) -> Result<CalibratedCamera, CameraError> {
    let colour = colour.of_one_plane();
    let total = series.groups.len() + 1;
    let mut reading = Reading { reader: FrameReader::new(series, colour), progress, done: 0, total };
    let (darks, lights): (Vec<&FrameGroup>, Vec<&FrameGroup>) = series.groups.iter().partition(|group| group.is_dark);
    let dark = DarkFrames::read(&mut reading, &darks)?;
    let mut brightest = dark.map.range.1;
    let (mut levels, mut copies) = (Vec::new(), dark.copies.clone());
    for group in lights {
        let stack = reading.read(group)?;
        brightest = brightest.max(stack.range.1);
        check_steady(series, group, &stack, &dark.map)?;
        copies.add(group, &stack);
        let step = step_of(group, &stack, &dark.counts);
        levels.push((step.sums.moments(None).mean, group, step));
    }
    let has_colour = reading.reader.colour_text.is_some() || reading.reader.names_channel;
    if colour.is_of_colour_images() && !has_colour {
        return Err(CameraError::Colour {
            path: series.path.clone(),
            expected: "colour images, whose channel is chosen",
            found: "grey frames",
            advice: "leave the channel out, or choose r, g1, g2 or b of raw mosaics",
        });
    }
    levels.sort_by(|(one, ..), (other, ..)| one.total_cmp(other));
    let (lights, steps): (Vec<&FrameGroup>, Vec<Step>) =
        levels.into_iter().map(|(_, group, step)| (group, step)).unzip();

    let (shape, step) = (dark.map.shape, reading.reader.step());
    let mut notes = frame_notes(series, &reading.reader, shape, f64::from(brightest));
    let top = series.bits.map(|bits| f64::from(bits).exp2() - 1.0);
    let steps = TransferSeries { path: &series.path, darks: dark.steps.clone(), lights: steps, step, top };
    let transfer = steps.evaluate()?;
    notes.extend(transfer.notes.iter().cloned());
    notes.extend(dark.hot_pixel_note());
    notes.extend(copies.note());
    let flat = match flat_level(&transfer) {
        Some(level) => Some((transfer.levels[level].signal_dn, reading.read(lights[level])?)),
        None => None,
    };
    let pixels = PixelDifferences::of(dark, flat.as_ref(), step, &mut notes);
    let dsnu_electrons = pixels.dsnu_dn.map(|dsnu| dsnu / transfer.gain);
    let prnu_percent = pixels.prnu_percent;
    let lists = [&pixels.hot, &pixels.dim].map(|list| PixelList::of(list, shape.1));
    let calibration = quantities(transfer, shape, step, lists, notes);
    let colour = reading.reader.colour_text;
    let calibration = CameraCalibration { dsnu_electrons, prnu_percent, colour, ..calibration };
    Ok(CalibratedCamera { calibration, maps: pixels.maps(shape) })
}

/// Dark frames of all exposures.
struct DarkFrames {
    steps: Vec<Step>,
    /// The group of most frames, whose mean shows hot pixels best.
    map: FrameStack,
    outliers: Outliers,
    /// Pixels that do not stand out.
    counts: Vec<bool>,
    /// Temporal standard deviation over all pixels, DN.
    noise_of_all: f64,
    copies: Copies,
}

impl DarkFrames {
    fn read(reading: &mut Reading<'_>, groups: &[&FrameGroup]) -> Result<Self, CameraError> {
        let (mut stacks, mut copies) = (Vec::new(), Copies::default());
        for group in groups {
            let stack = reading.read(group)?;
            copies.add(group, &stack);
            stacks.push(stack);
        }
        if let Some(Wrapped { share, above, median }) =
            reading.reader.wrapped().filter(|found| found.share > MOST_WRAPPED)
        {
            let (path, percent) = (reading.reader.series.path.clone(), 100.0 * share);
            return Err(CameraError::DarkWrapped { path, percent, above, median });
        }
        let best = (0..stacks.len()).max_by_key(|&index| stacks[index].frames).unwrap_or_default();
        let shape = stacks[best].shape;
        let outliers = outliers(&stacks[best].mean, shape, reading.reader.step());
        let all = vec![true; shape.0 * shape.1];
        let noise_of_all = BlockSums::of(&stacks[best], &all).moments(None).variance.sqrt();
        let mut counts = all;
        leave_out(&mut counts, &outliers);
        let steps = groups.iter().zip(&stacks).map(|(group, stack)| step_of(group, stack, &counts)).collect();
        Ok(Self { steps, map: stacks.swap_remove(best), outliers, counts, noise_of_all, copies })
    }

    fn hot_pixel_note(&self) -> Option<String> {
        let hot = self.outliers.above.len();
        (hot > 0).then(|| {
            format!(
                "{} {} left out of all means and variances; with {} the dark noise is {:.3} DN",
                counted(hot, "hot pixel"),
                one_or_many(hot, "is", "are"),
                one_or_many(hot, "it", "them"),
                self.noise_of_all
            )
        })
    }
}

fn leave_out(counts: &mut [bool], outliers: &Outliers) {
    for &pixel in outliers.above.iter().chain(&outliers.below) {
        counts[pixel] = false;
    }
}

/// What distinguishes the pixels of a sensor.
struct PixelDifferences {
    dsnu_dn: Option<f64>,
    prnu_percent: Option<f64>,
    hot: Vec<usize>,
    dim: Vec<usize>,
    /// Dark signal of each pixel, DN; `None` where its differences lie below the noise of the mean frame.
    dark: Option<Vec<f64>>,
    /// Response of each pixel; `None` as for the dark signal.
    response: Option<Vec<f64>>,
}

impl PixelDifferences {
    /// Compares pixels in the dark and in a flat light level with its signal in DN.
    fn of(dark: DarkFrames, flat: Option<&(f64, FrameStack)>, step: f64, notes: &mut Vec<String>) -> Self {
        let DarkFrames { map: dark_map, outliers: in_dark, mut counts, .. } = dark;
        let shape = dark_map.shape;
        let in_dark_variance =
            (dark_map.frames >= SPATIAL_FRAMES).then(|| spatial_variance(&dark_map.mean, &dark_map, &counts));
        let mut found = Self {
            dsnu_dn: in_dark_variance.map(|variance| variance.fixed.sqrt()),
            prnu_percent: None,
            hot: in_dark.above,
            dim: in_dark.below,
            dark: None,
            response: None,
        };
        if let Some((signal, stack)) = flat {
            let pairs = stack.mean.iter().zip(&dark_map.mean);
            let response: Vec<f64> = pairs.map(|(light, dark)| (light - dark) / signal).collect();
            let in_light = outliers(&response, shape, step / signal);
            leave_out(&mut counts, &in_light);
            for (list, more) in [(&mut found.hot, in_light.above), (&mut found.dim, in_light.below)] {
                list.extend(more);
                list.sort_unstable();
                list.dedup();
            }
            let in_light = spatial_variance(&stack.mean, stack, &counts);
            if let (true, Some(in_dark)) = (stack.frames >= SPATIAL_FRAMES, in_dark_variance) {
                let of_response = (in_light.fixed - in_dark.fixed).max(0.0);
                found.prnu_percent = Some(100.0 * of_response.sqrt() / signal);
                if is_shaded(&response, shape, SHADING_PX, in_light.temporal / signal / signal) {
                    let note = "most of the PRNU is smooth shading by light or lens, and no difference of neighbours";
                    notes.push(note.into());
                }
                found.response = (of_response > in_light.temporal).then_some(response);
            }
        }
        found.dark = in_dark_variance.filter(|variance| variance.fixed > variance.temporal).map(|_| dark_map.mean);
        let missing = [
            (found.dsnu_dn.is_none(), "DSNU", "in the dark"),
            (found.prnu_percent.is_none(), "PRNU", "in the dark and near half of saturation"),
        ];
        let missing = missing.iter().filter(|(is_missing, ..)| *is_missing);
        notes.extend(
            missing.map(|(_, name, place)| format!("no {name}: it needs {SPATIAL_FRAMES} or more frames {place}")),
        );
        found
    }

    fn maps(self, shape: (usize, usize)) -> CameraMaps {
        let map = |values: Vec<f64>| Array2::from_shape_fn(shape, |(row, col)| values[row * shape.1 + col] as f32);
        let mut mask = vec![0.0; shape.0 * shape.1];
        for (pixels, kind) in [(self.hot, 1.0), (self.dim, 2.0)] {
            for pixel in pixels {
                mask[pixel] = kind;
            }
        }
        CameraMaps { dark_signal_dn: self.dark.map(map), response: self.response.map(map), mask: map(mask) }
    }
}

/// Refuses a light level whose frames differ in brightness: they are several levels.
fn check_steady(
    series: &FrameSeries,
    group: &FrameGroup,
    stack: &FrameStack,
    dark: &FrameStack,
) -> Result<(), CameraError> {
    let mean = |stack: &FrameStack| stack.mean.iter().sum::<f64>() / stack.mean.len() as f64;
    let (low, high) = stack.frame_means;
    let noise = (stack.variance.iter().sum::<f64>() / (stack.variance.len() as f64).powi(2)).sqrt();
    if high - low > MOST_FLICKER * (mean(stack) - mean(dark)).abs() + 10.0 * noise {
        return Err(CameraError::Unsteady { path: series.path.clone(), group: group.label.clone(), low, high });
    }
    Ok(())
}

/// The light level for the PRNU: of those with most frames near half of saturation the nearest.
fn flat_level(transfer: &PhotonTransfer) -> Option<usize> {
    let share = |level: &LightLevel| level.signal_dn / transfer.saturation_dn;
    let candidates = || transfer.levels.iter().enumerate().filter(|(_, level)| PRNU_RANGE.contains(&share(level)));
    let most = candidates().map(|(_, level)| level.frames).max()?;
    let least = most.min(SPATIAL_FRAMES);
    let distance = |level: &LightLevel| (share(level) - PRNU_SHARE).abs();
    let enough = candidates().filter(|(_, level)| level.frames >= least);
    enough.min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b))).map(|(index, _)| index)
}

/// Quantities that follow from the photon transfer.
fn quantities(
    transfer: PhotonTransfer,
    (rows, cols): (usize, usize),
    step: f64,
    [hot_pixels, dim_pixels]: [PixelList; 2],
    mut notes: Vec<String>,
) -> CameraCalibration {
    let gain = transfer.gain;
    let saturation_electrons = transfer.saturation_dn / gain;
    // The signal of SNR 1: EMVA 1288 release 4.0, equation 24.
    let rounding = ROUNDING_VARIANCE * (step / gain).powi(2);
    let least_electrons = (transfer.noise_electrons.powi(2) + rounding).sqrt() + 0.5;
    let line = linearity(&transfer.levels, transfer.saturation_dn);
    if line.is_none() {
        notes.push("no linearity error: it needs three or more light levels of known exposure or photons".into());
    }
    let quantum_efficiency = quantum_efficiency(&transfer.levels, transfer.saturation_dn, gain);
    if let Some(efficiency) = quantum_efficiency.filter(|efficiency| *efficiency > 1.0) {
        notes.push(format!("a quantum efficiency of {efficiency:.2} is above 1: check the photons of the descriptor"));
    }
    CameraCalibration {
        system_gain_dn_per_electron: gain,
        system_gain_dn_per_electron_interval_95: transfer.gain_interval,
        dark_signal_dn: transfer.dark_signal,
        dark_signal_dn_interval_95: transfer.dark_signal_interval,
        temporal_dark_noise_dn: transfer.noise_dn,
        temporal_dark_noise_dn_interval_95: transfer.noise_dn_interval,
        temporal_dark_noise_electrons: transfer.noise_electrons,
        temporal_dark_noise_electrons_interval_95: transfer.noise_electrons_interval,
        saturation_dn: transfer.saturation_dn + transfer.dark_signal,
        saturation_electrons,
        snr_max_db: 10.0 * saturation_electrons.log10(),
        dynamic_range_db: 20.0 * (saturation_electrons / least_electrons).log10(),
        linearity_error_percent: line.map(|line| line.error_percent),
        dsnu_electrons: None,
        prnu_percent: None,
        quantum_efficiency,
        hot_pixels,
        dim_pixels,
        rows,
        cols,
        grey_value_step_dn: step,
        colour: None,
        light_levels: transfer.levels,
        notes,
    }
}
