//! Computing the cells of a study.

use std::collections::HashMap;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use super::cell::{CellRecord, CellSettings, StudyMask};
use super::folder::{CellState, StudyFolder};
use super::ideal::designed;
use super::plan::times_of;
use super::shard::Shard;
use super::shared::{SharedEstimate, SharedEstimates};
use crate::evaluation::estimation::estimate_on_patches;
use crate::evaluation::{EstimateProgress, EstimateRequest, EvaluationError};
use crate::formats::{FormatError, content_key, json_of, lock_name, remove_if_there};
use crate::forward::{Design, ForwardModel, MaskError, notices_of, open_set};
use crate::information::{Estimate, NUMBERS_VERSION, TestPatches};
use crate::optics::Encoder;
use crate::progress::Progress;
use crate::reconstruction::{DecoderQuality, ReconstructionError};
use crate::sensor::Patches;
use crate::sparsity::{TamuraSummary, tamura_of_stack};
use crate::studies::error::StudyError;
use crate::studies::machine::Machine;

/// Measurements whose patches give the sensor's Tamura coefficient.
const TAMURA_MEASUREMENTS: usize = 64;
/// Patches of these measurements.
const TAMURA_PATCHES: usize = 256;
/// Side of such a patch, pixels: the published one.
const TAMURA_SIDE: usize = 32;

/// An event of a running study.
#[derive(Clone, Debug, PartialEq)]
pub enum PlanEvent<'a> {
    /// A cell is being computed.
    Step {
        /// Place of the cell in the plan.
        index: usize,
        /// Number of the cell among those of this run, from 1.
        number: usize,
        /// Cells of this run.
        cells: usize,
        /// Settings of the cell.
        cell: &'a CellSettings,
        /// The current step, for people.
        step: &'a str,
        /// Estimated time for this cell and the later ones.
        left: Duration,
    },
    /// A cell was computed, or failed, and its file is written.
    Done {
        /// Place of the cell in the plan.
        index: usize,
        /// Number of the cell among those of this run, from 1.
        number: usize,
        /// Cells of this run.
        cells: usize,
        /// The cell.
        record: &'a CellRecord,
    },
}

/// Outcome of [`run_cells`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunSummary {
    /// Cells of this share of the plan.
    pub cells: usize,
    /// Cells that were done before.
    pub before: usize,
    /// Cells that failed.
    pub failed: usize,
}

/// Computes the cells of a share of the plan that have no result. Whatever stops it costs at most the seconds since the last checkpoint
/// of the current cell.
///
/// # Errors
/// [`StudyError::Cancelled`] where `progress` cancels, and where a file cannot be written.
pub fn run_cells(
    folder: &StudyFolder,
    shard: Shard,
    progress: &mut (dyn for<'a> Progress<PlanEvent<'a>> + Send),
) -> Result<RunSummary, StudyError> {
    let mut prints = Fingerprints::default();
    let ranks = folder.ranks();
    let own: Vec<usize> = (0..ranks.len()).filter(|&index| shard.holds(ranks[index])).collect();
    let mut todo = Vec::new();
    let mut shared = SharedEstimates::default();
    for &index in &own {
        let is_done = match folder.state(index)? {
            CellState::Done(record) => prints.agree(&record),
            _ => false,
        };
        if is_done {
            shared.note(index, &folder.cells()[index]);
        } else {
            todo.push(index);
        }
    }
    let cells = todo.len();
    let mut summary = RunSummary { cells: own.len(), before: own.len() - cells, failed: 0 };
    let machine = Machine::here();
    let mut clock = Clock::default();
    let planned = times_of(todo.iter().map(|&index| &folder.cells()[index]));
    let mut planned_later: Duration = planned.iter().sum();
    for (done, (&index, &planned)) in todo.iter().zip(&planned).enumerate() {
        let cell = &folder.cells()[index];
        planned_later = planned_later.saturating_sub(planned);
        let (expected, later) = (clock.expect(planned), clock.expect(planned_later));
        let finished = shared.of(folder, cell)?;
        let start = Instant::now();
        let mut report = |step: &str| {
            let left = later + expected.saturating_sub(start.elapsed());
            progress.report(&PlanEvent::Step { index, number: done + 1, cells, cell, step, left })
        };
        let result = match compute(folder, index, finished, &mut report) {
            Err(CellError::Stopped) => return Err(StudyError::Cancelled),
            Err(CellError::Disk(error)) => return Err(error.into()),
            Err(CellError::Failed(sentence)) => Err(sentence),
            Ok(computed) => Ok(computed),
        };
        let record = record_of(cell, result, start.elapsed(), machine.clone());
        clock.add(planned, start.elapsed());
        summary.failed += usize::from(record.estimate.is_none());
        folder.put(index, &record)?;
        if record.estimate.is_some() {
            shared.note(index, cell);
        }
        let request = EstimateRequest { keep: Some(folder.state_file(index)), ..cell.request() };
        request.end_kept();
        remove_if_there(&folder.design_state_file(index))?;
        if progress.report(&PlanEvent::Done { index, number: done + 1, cells, record: &record }).is_break() {
            return Err(StudyError::Cancelled);
        }
    }
    Ok(summary)
}

/// Ratio of measured to planned times, for the time that is left.
#[derive(Default)]
struct Clock {
    planned: Duration,
    measured: Duration,
}

impl Clock {
    fn add(&mut self, planned: Duration, measured: Duration) {
        self.planned += planned;
        self.measured += measured;
    }

    fn expect(&self, planned: Duration) -> Duration {
        if self.planned.is_zero() {
            return planned;
        }
        planned.mul_f64(self.measured.as_secs_f64() / self.planned.as_secs_f64())
    }
}

/// What a cell gives.
struct Computed {
    encoder: Encoder,
    measured: Measured,
    /// Id of the cell that the estimate was taken from.
    estimate_of: Option<String>,
    reconstruction: Option<DecoderQuality>,
}

/// What cells share that differ in their reconstruction alone.
struct Measured {
    estimate: Estimate,
    test_patches: TestPatches,
    sensor_tamura: Option<TamuraSummary>,
    notices: Vec<String>,
}

/// Reason why a cell has no result.
pub(super) enum CellError {
    /// The run was stopped.
    Stopped,
    /// A file of the folder cannot be read or written; the other cells would fail as well.
    Disk(FormatError),
    /// The cell itself.
    Failed(String),
}

impl From<EvaluationError> for CellError {
    fn from(error: EvaluationError) -> Self {
        if error.is_cancelled() { Self::Stopped } else { Self::Failed(error.to_string()) }
    }
}

impl From<MaskError> for CellError {
    fn from(error: MaskError) -> Self {
        Self::Failed(error.to_string())
    }
}

impl From<FormatError> for CellError {
    fn from(error: FormatError) -> Self {
        Self::Disk(error)
    }
}

fn compute(
    folder: &StudyFolder,
    index: usize,
    finished: Option<SharedEstimate>,
    report: &mut (dyn FnMut(&str) -> ControlFlow<()> + Send),
) -> Result<Computed, CellError> {
    let cell = &folder.cells()[index];
    if let Some(finished) = &finished {
        finished.copy_design(folder, index)?;
    }
    let opened = cell.open_mask()?;
    let start = opened.encoder;
    let encoder = match &cell.mask {
        StudyMask::Given(_) => start,
        StudyMask::Ideal { freedom, .. } => designed(folder, index, *freedom, cell.design(start), report)?,
    };
    let design = cell.design(encoder);
    let estimate_of = finished.as_ref().map(|finished| finished.id(folder));
    let measured = match finished.and_then(|finished| Measured::of(*finished.record)) {
        Some(measured) => measured,
        None => measured(folder, index, &design, opened.notices, report)?,
    };
    let reconstruction = quality(cell, &design, report)?;
    Ok(Computed { encoder: design.encoder, measured, estimate_of, reconstruction })
}

impl Measured {
    fn of(record: CellRecord) -> Option<Self> {
        let CellRecord { estimate, test_patches, sensor_tamura, notices, .. } = record;
        Some(Self { estimate: estimate?, test_patches, sensor_tamura, notices })
    }
}

fn measured(
    folder: &StudyFolder,
    index: usize,
    design: &Design,
    of_mask: Vec<String>,
    report: &mut (dyn FnMut(&str) -> ControlFlow<()> + Send),
) -> Result<Measured, CellError> {
    let model = ForwardModel::open(design).map_err(EvaluationError::from)?;
    let sensor_tamura = tamura_of(&model, design)?;
    let of_objects = notices_of(design, &model.set).map_err(EvaluationError::from)?;
    let notices = of_mask.into_iter().chain(of_objects).collect();
    // Where another process computes the same cell, this one keeps no state. Both results are the same, and one replaces the other.
    let state = folder.state_file(index);
    let lock = lock_name(&state, &state.with_extension("lock"));
    let keep = lock.is_ok().then_some(state);
    let request = EstimateRequest { keep, ..folder.cells()[index].request() };
    let (estimate, test_patches) =
        estimate_on_patches(design, &request, &mut |step: &EstimateProgress| report(&step.step))?;
    Ok(Measured { estimate, test_patches, sensor_tamura, notices })
}

/// The image quality of the plan's decoder, where the plan has one.
fn quality(
    cell: &CellSettings,
    design: &Design,
    report: &mut (dyn FnMut(&str) -> ControlFlow<()> + Send),
) -> Result<Option<DecoderQuality>, CellError> {
    let Some(settings) = cell.reconstruction else { return Ok(None) };
    let step = format!("reconstruction by {}", settings.decoder);
    let request = settings.request(cell.estimates.protocol, cell.seed);
    match request.measure(design, &mut || report(&step)) {
        Ok(quality) => Ok(Some(quality)),
        Err(ReconstructionError::Cancelled) => Err(CellError::Stopped),
        Err(error) => Err(CellError::Failed(error.to_string())),
    }
}

/// The Tamura coefficient of noisy patches, as published: background included.
fn tamura_of(model: &ForwardModel, design: &Design) -> Result<Option<TamuraSummary>, EvaluationError> {
    let psf = model.psf(design)?;
    let noisy = model.simulate(psf.view(), 0..TAMURA_MEASUREMENTS, design.seed)?.noisy;
    let patch = model.patch(Some((TAMURA_SIDE, TAMURA_SIDE)));
    let patches = Patches::draw(noisy.dim(), patch, TAMURA_PATCHES, design.seed)?;
    let values = tamura_of_stack(patches.cut(noisy.view()).view());
    Ok(TamuraSummary::of(values.as_slice().unwrap_or(&[])))
}

fn record_of(cell: &CellSettings, result: Result<Computed, String>, time: Duration, machine: Machine) -> CellRecord {
    let failed = |sentence: String| CellRecord {
        settings: cell.clone(),
        program_version: NUMBERS_VERSION.into(),
        lenslets: None,
        encoder: cell.mask.to_string(),
        mask_fingerprint: String::new(),
        estimate: None,
        estimate_of: None,
        failure: Some(sentence),
        sensor_tamura: None,
        reconstruction: None,
        notices: Vec::new(),
        test_patches: TestPatches::default(),
        seconds: time.as_secs_f64(),
        machine: machine.clone(),
    };
    match result {
        Err(sentence) => failed(sentence),
        Ok(computed) if !computed.measured.estimate.is_finite() => {
            failed("the estimate is not a finite number; give the fit more time".into())
        }
        Ok(Computed { encoder, measured, estimate_of, reconstruction }) => CellRecord {
            lenslets: encoder.lenslets().map(|array| array.lenslets.len()),
            encoder: encoder.describe(),
            mask_fingerprint: content_key(&json_of(&encoder)),
            estimate: Some(measured.estimate),
            estimate_of,
            failure: None,
            sensor_tamura: measured.sensor_tamura,
            reconstruction,
            notices: measured.notices,
            test_patches: measured.test_patches,
            ..failed(String::new())
        },
    }
}

/// Fingerprints of files that results came from, each read once.
#[derive(Default)]
struct Fingerprints {
    objects: HashMap<String, Option<String>>,
    masks: HashMap<String, Option<String>>,
}

impl Fingerprints {
    /// Whether the files of a cell are those that its result came from. Objects and masks that are drawn cannot change.
    fn agree(&mut self, record: &CellRecord) -> bool {
        let CellRecord { settings, estimate, mask_fingerprint, .. } = record;
        let Some(estimate) = estimate else { return false };
        if settings.objects.is_read() && self.objects(settings) != Some(&estimate.objects_fingerprint) {
            return false;
        }
        let is_read = settings.mask.source().path().is_some();
        let is_given = matches!(settings.mask, StudyMask::Given(_));
        !(is_read && is_given) || self.mask(settings) == Some(mask_fingerprint)
    }

    fn objects(&mut self, settings: &CellSettings) -> Option<&String> {
        let CellSettings { objects, field, .. } = settings;
        let open = || open_set(&settings.design(Design::default().encoder)).ok().map(|set| set.fingerprint());
        self.objects.entry(format!("{field} {objects}")).or_insert_with(open).as_ref()
    }

    fn mask(&mut self, settings: &CellSettings) -> Option<&String> {
        let CellSettings { mask, grid, .. } = settings;
        let open = || settings.open_mask().ok().map(|opened| content_key(&json_of(&opened.encoder)));
        self.masks.entry(format!("{grid} {mask}")).or_insert_with(open).as_ref()
    }
}
