//! A run from a design, in the hands of whoever keeps its states.

use std::fs::File;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::design::{Ideal, IdealSettings, Objective, OnIdeal};
use crate::evaluation::EvaluationError;
use crate::evaluation::scene::ceiling_of;
use crate::formats::{
    DocumentKind, FormatError, check_writable, create_folder, lock_folder, read_if_there, write_safely,
};
use crate::forward::Design;
use crate::forward::ForwardModel;
use crate::forward::{forward_model, open_set_with};
use crate::objects::Progress;
use crate::optics::{Encoder, LensletArray, render_psf};
use crate::studies::{STUDY_RECORD, Study, StudyError, StudyRecord, StudySettings};
use crate::workbench::ideal::design_run::{RankedStart, Start};
use crate::workbench::ideal::record::IdealRecord;
use crate::workbench::ideal::score::is_about;

/// Takes a state of a run, which lies between two of its rounds.
pub(super) type Keep<'a> = &'a mut dyn FnMut(&Ideal<'_>) -> Result<(), EvaluationError>;

/// Where a run goes on.
#[derive(Clone, Copy, Debug)]
pub struct GoOn<'a> {
    /// A state of the same run.
    pub state: &'a [u8],
    /// An earlier mask to go on from, by its frame; the newest one where there is none.
    pub rewind_to: Option<usize>,
}

/// Lets the mask of a design climb the information of its measurements, from the start or from where the same run goes on
/// (`from`); `reading` hears how far the objects are read, `keep` gets the run after every round.
///
/// # Errors
/// Where design, objects, noise and settings allow no run, a state is of another one, or `reading` or `watch` break off.
pub fn run_ideal(
    design: &Design,
    settings: &IdealSettings,
    from: Option<GoOn<'_>>,
    reading: &dyn Fn(Progress) -> ControlFlow<()>,
    keep: Keep<'_>,
    watch: OnIdeal<'_>,
) -> Result<IdealRecord, EvaluationError> {
    // The result is judged by the test part, of which a run sees nothing.
    let set = open_set_with(design, reading)?.of_training();
    let imaging = forward_model(design, &set)?;
    let mut ideal = Ideal::new(&imaging, start_of(design)?, design.limits, settings.clone())?;
    if let Some(GoOn { state, rewind_to }) = from {
        ideal = ideal.resumed(state)?;
        ideal.extend_to(settings.steps);
        if let Some(frame) = rewind_to {
            ideal.rewind_to(frame)?;
            keep(&ideal)?;
        }
    }
    while !ideal.is_finished() {
        ideal.advance(watch)?;
        keep(&ideal)?;
    }
    let notices = set.notices().iter().cloned().chain(above_ceiling(design, &imaging, &ideal)).collect();
    Ok(IdealRecord { notices, ..IdealRecord::new(design, &ideal) })
}

/// A sentence where a density model puts the last mask above what its objects hold at all.
fn above_ceiling(design: &Design, imaging: &ForwardModel<'_>, ideal: &Ideal<'_>) -> Option<String> {
    let settings = ideal.settings();
    let last = ideal.state().frames.last().filter(|_| settings.objective != Objective::Posterior)?;
    let psf = render_psf(&last.array, imaging.set.planes()).ok()?;
    let ceiling = ceiling_of(design, imaging.set, psf.view(), imaging.patch(settings.patch)).ok()??.bits_per_pixel;
    (last.interval_95[0] > ceiling).then(|| {
        let bits = last.bits_per_pixel;
        format!(
            "the run's estimate lies above what the objects hold at all, {bits:.3} of at most {ceiling:.3} bits per pixel: judge \
             the design by a bracket"
        )
    })
}

/// The lenslets of a design.
pub(super) fn start_of(design: &Design) -> Result<&LensletArray, EvaluationError> {
    design.encoder.lenslets().ok_or_else(|| EvaluationError::NoLenslets { mask: design.encoder.describe() })
}

/// The kind of the file of an order.
const RUN_ORDER: DocumentKind = DocumentKind::unmarked_before("lenslet-studio/run-order", "an order of runs");

/// Ending of the files of states.
const STATE: &str = "safetensors";

/// A folder that holds the last states of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeptRun {
    folder: PathBuf,
}

/// An order of one run or several: beside the state of the one that it is at this is all that is needed to go on.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct KeptOrder {
    /// What is started from, one after the other.
    pub starts: Vec<Start>,
    /// What is done.
    pub settings: IdealSettings,
    /// Index of the start whose state is kept.
    pub at: usize,
    /// Whether no start after that is to be run any more: it goes on by itself.
    #[serde(default)]
    pub alone: bool,
    /// Results of the starts that came to their end, the best first.
    pub ranked: Vec<RankedStart>,
    /// What failed, a sentence for each.
    #[serde(default)]
    pub failures: Vec<String>,
    /// The last of the masks that is in a file of a person's.
    #[serde(default)]
    pub saved: Option<LensletArray>,
    /// Time for each of their estimates, seconds; none where these take so many steps.
    #[serde(default)]
    pub budget_seconds: Option<f64>,
}

impl KeptOrder {
    /// An order of which nothing is done yet.
    pub fn new(starts: Vec<Start>, settings: IdealSettings) -> Self {
        Self {
            starts,
            settings,
            at: 0,
            alone: false,
            ranked: Vec::new(),
            failures: Vec::new(),
            saved: None,
            budget_seconds: None,
        }
    }
}

impl KeptRun {
    /// The run in `folder`, which is made if need be.
    ///
    /// # Errors
    /// Where the folder cannot be made, and where a newer program has written the order in it.
    pub fn in_folder(folder: &Path) -> Result<Self, EvaluationError> {
        create_folder(folder)?;
        let run = Self { folder: folder.to_path_buf() };
        if RUN_ORDER.is_newer(&run.order()) {
            RUN_ORDER.read::<KeptOrder>(&run.order())?;
        }
        Ok(run)
    }

    /// Keeps other programs out of it while the file is there, which would write their states over those of this one.
    ///
    /// # Errors
    /// [`FormatError::Busy`](crate::formats::FormatError::Busy) where another program has it.
    pub fn lock(&self) -> Result<Option<File>, EvaluationError> {
        Ok(lock_folder(&self.folder)?)
    }

    /// Where the state of a single run lies.
    pub fn run_file(&self) -> PathBuf {
        self.state(0)
    }

    /// Whether an order is in the folder.
    pub fn has_order(&self) -> bool {
        self.order().exists()
    }

    /// Refuses a folder whose files cannot be written, before anything long is computed.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`](crate::formats::FormatError::NotWritten) for the first of them.
    pub fn check_writable(&self) -> Result<(), EvaluationError> {
        Ok([self.state(0), self.order()].iter().try_for_each(|file| check_writable(file))?)
    }

    /// The file of the state of a start, by its index.
    fn state(&self, start: usize) -> PathBuf {
        let number = if start == 0 { String::new() } else { format!("-{}", start + 1) };
        self.folder.join(format!("run{number}.{STATE}"))
    }

    fn comparison_folder(&self) -> PathBuf {
        self.folder.join("score")
    }

    /// The comparison of a result, as far as it was computed; one of another result makes room for it.
    pub(super) fn comparison(&self, settings: StudySettings) -> Result<Study, StudyError> {
        let folder = self.comparison_folder();
        match Study::open(settings.clone(), &folder) {
            Err(error) if error.is_about_another() => {
                std::fs::remove_dir_all(&folder).map_err(|error| FormatError::from_write(&folder, error))?;
                Study::open(settings, &folder)
            }
            opened => opened,
        }
    }

    /// What was computed of the comparison of a result, the mask of a run.
    pub fn compared(&self, result: &Encoder) -> Option<StudyRecord> {
        let file = self.comparison_folder().join(STUDY_RECORD);
        StudyRecord::open(&file).ok().filter(|study| is_about(study, result))
    }

    fn order(&self) -> PathBuf {
        self.folder.join("order.json")
    }

    /// The state of a start that was kept last, if any.
    ///
    /// # Errors
    /// Where the file cannot be read.
    pub fn load(&self, start: usize) -> Result<Option<Vec<u8>>, EvaluationError> {
        Ok(read_if_there(&self.state(start))?)
    }

    /// Puts the state of the run from a start in place of the last one, safely.
    ///
    /// # Errors
    /// Where the file cannot be written; the last state is then still there.
    pub fn store(&self, start: usize, state: &[u8]) -> Result<(), EvaluationError> {
        Ok(write_safely(&self.state(start), |out| out.write_all(state))?)
    }

    /// Notes what was ordered, and how far it is.
    ///
    /// # Errors
    /// Where the file cannot be written; the last note is then still there.
    pub fn note(&self, order: &KeptOrder) -> Result<(), EvaluationError> {
        Ok(RUN_ORDER.write(&self.order(), order)?)
    }

    /// Forgets the run.
    pub fn end(&self) {
        let found = std::fs::read_dir(&self.folder).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
        let states = found.filter(|file| file.extension().is_some_and(|ending| ending == STATE));
        for file in states.chain([self.order()]) {
            // One that stays behind is replaced by the next.
            let _ = std::fs::remove_file(file);
        }
        let _ = std::fs::remove_dir_all(self.comparison_folder());
    }

    /// What was ordered here last, and the states of its starts, as far as they got; none where files are missing or broken.
    pub fn last(&self) -> Option<(KeptOrder, Vec<Option<Vec<u8>>>)> {
        let mut order: KeptOrder = RUN_ORDER.read(&self.order()).ok()?;
        let sound = order.at < order.starts.len()
            && order.starts.iter().all(|start| start.design.check().is_ok())
            && order.ranked.iter().all(|result| result.design.check().is_ok());
        // The others are looked at where one of them is to go on.
        let is_wanted = |start: usize, bytes: &[u8]| start != order.at || Ideal::state_in(bytes).is_ok();
        let read = |start| self.load(start).ok()?.filter(|bytes| is_wanted(start, bytes));
        let states: Vec<_> = (0..order.starts.len()).map(read).collect();
        let is_done = |at: usize| order.ranked.iter().any(|result| result.name == order.starts[at].name);
        if sound && is_done(order.at) && states[order.at].is_none() && order.at + 1 < order.starts.len() {
            // It ended between two starts.
            order.at += 1;
        }
        sound.then_some((order, states))
    }
}
