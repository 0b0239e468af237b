//! Requests of panels and dialogs.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use crate::evaluation::EstimateRequest;
use crate::forward::Design;
use crate::information::EngineChoice;
use crate::objects::ObjectSource;
use crate::optics::LensletArray;
use crate::reconstruction::TrainingBudget;
use crate::studio::state::action::Action;
use crate::studio::state::messages::Severity;
use crate::studio::state::pane::Pane;
use crate::studio::state::path_dialog::{PathPurpose, PathQuestion};
use crate::studio::state::preferences::RendererChoice;
use crate::studio::state::transition::Transition;
use crate::studio::widgets::number_field::Edit;
use crate::workbench::{
    Activity, CalibrationOrder, CaptureOrder, Command, ComparisonOrder, FinishedEstimate, Job, Recovered,
    SystemCaptures, TrainingScope,
};

/// A request of a panel or a dialog. It is served when that is drawn, in the same frame.
pub enum Request {
    /// Runs an action.
    Do(Action),
    /// Changes the design, as one undo step with the other changes of the gesture.
    Change(Command),
    /// Changes the design by an edit of a number field.
    ChangeBy(Edit, Command),
    /// Changes the design, as an undo step of its own.
    ChangeInOneStep(Command),
    /// Locks lenslets, or unlocks them if all are locked.
    ToggleLocks(BTreeSet<usize>),
    /// Opens a snapshot in place of the design.
    OpenSnapshot(u64),
    /// Performs a transition, after a confirmation if something would be lost.
    Transition(Transition),
    /// Performs a confirmed transition.
    Confirmed(Transition),
    /// Recovers a design of a crashed session.
    Recover(Box<Recovered>),
    /// Opens objects.
    OpenObjects(ObjectSource),
    /// Opens the dialog that imports a PSF, for this path.
    OpenPsf(String),
    /// Sets the PSF grid of a diffuser, pixels.
    ResizeDiffuser(usize),
    /// Uses an image as the PSF; the path holds the options of the import.
    ImportPsf(PathBuf),
    /// Acts on the run.
    Run(RunRequest),
    /// Acts on the training of a network.
    Training(TrainingRequest),
    /// Acts on the study.
    Study(StudyRequest),
    /// Acts on cameras.
    Camera(CameraRequest),
    /// Acts on estimates.
    Estimates(EstimatesRequest),
    /// Inspects the shown measurement: spectrum, information map.
    Inspect,
    /// Reconstructs the shown measurement.
    Reconstruct,
    /// Reconstructs a capture of a camera.
    ReconstructCapture(CaptureOrder),
    /// Stops that.
    StopCapture,
    /// Submits a job.
    Submit(Job),
    /// Stops a job.
    StopJob(Arc<Activity>),
    /// Stops reading a file.
    StopReading,
    /// Opens or closes the list of jobs.
    ToggleJobs,
    /// Asks for a path.
    AskPath(PathPurpose),
    /// Acts on an answered question for a path.
    UsePath(Box<PathQuestion>),
    /// Copies a text; `what` names it in the message.
    Copy {
        /// The text.
        text: String,
        /// Its name, for example "Log".
        what: &'static str,
    },
    /// Copies a command line, or reports why none exists.
    CopyCommand(Result<String, String>),
    /// Shows a text in the status bar until the next frame.
    Describe(String),
    /// Adds a message.
    Notify(Severity, String),
    /// Captures a panel as an image.
    Capture(Pane),
    /// Changes a setting.
    Set(Setting),
}

/// A request about the run.
pub enum RunRequest {
    /// Pauses or resumes it.
    Pause(bool),
    /// Resumes a stopped run, or extends a finished one by these steps.
    Extend(usize),
    /// Shows its masks as they come, or no longer.
    Follow(bool),
    /// Previews a mask.
    Preview {
        /// The mask.
        array: LensletArray,
        /// The design that it was made for.
        start: Arc<Design>,
        /// Whether later masks are shown as they come.
        follow: bool,
    },
    /// Compares the best result with heuristic layouts.
    Compare,
}

/// A request about the training of a network.
pub enum TrainingRequest {
    /// Trains a network for the shown design.
    Start(TrainingScope, TrainingBudget),
    /// Pauses or resumes the training.
    Pause(bool),
    /// Stops the training.
    Stop,
}

/// A request about the study.
pub enum StudyRequest {
    /// Opens the study of a folder.
    Open(PathBuf),
    /// Computes the cells without a result.
    Start,
    /// Pauses or resumes the study.
    Pause(bool),
    /// Stops the study.
    Stop,
    /// Opens the design of a cell.
    OpenCell(usize),
    /// Says why the plan of the form cannot be computed.
    Refused(String),
}

/// A request about cameras.
pub enum CameraRequest {
    /// Groups frames, calibrates a camera or opens its file.
    Calibrate(CalibrationOrder),
    /// Stops the calibration.
    StopCalibration,
    /// Reads captures for their previews.
    Preview(Arc<SystemCaptures>),
    /// Compares systems.
    Compare(Box<ComparisonOrder>),
    /// Stops the comparison.
    StopComparison,
}

/// A request about estimates.
pub enum EstimatesRequest {
    /// Estimates the design.
    Start(EstimateRequest),
    /// Cancels the running estimate.
    Cancel,
    /// Deletes a finished estimate.
    Delete(Arc<FinishedEstimate>),
    /// Restores the estimate that was deleted last.
    Restore,
}

/// A change of a setting.
pub enum Setting {
    /// Whether live estimates are computed.
    Live(bool),
    /// Whether zoom and cursor of object, measurement and reconstruction are linked.
    LinkViews(bool),
    /// Number of compute threads; one per core if none is chosen.
    Threads(Option<usize>),
    /// Engine of the PixelCNN.
    Engine(EngineChoice),
    /// Renderer from the next start on.
    Renderer(RendererChoice),
    /// Folder of unsaved changes; none for the default one.
    UnsavedFolder(Option<PathBuf>),
    /// The welcome dialog was shown.
    Welcomed,
    /// Forgets recent design files.
    ClearRecent,
}
