//! What panels and dialogs read of the window.

use std::path::Path;
use std::sync::Arc;

use crate::evaluation::Measurements;
use crate::forward::Design;
use crate::studio::canvas::image_view::ColourPalettes;
use crate::studio::state::action::Action;
use crate::studio::state::locks::Locks;
use crate::studio::state::optimize::OptimizeState;
use crate::studio::state::panel_states::Panels;
use crate::studio::state::preferences::Preferences;
use crate::studio::state::samples::ShownSample;
use crate::workbench::{
    CameraResults, CaptureReconstruction, Colormap, DesignRun, Estimates, InspectionKey, Live, LiveEstimate,
    LiveRecord, Reconstructions, Revisioned, RunStatus, StudyView, Trainings,
};

/// What panels and dialogs read of the window, beside their own state. They change it by requests alone.
pub struct View<'a> {
    /// The shown design.
    pub design: &'a Arc<Design>,
    /// Its revision.
    pub revision: u64,
    /// The open design; another one than the shown one during a preview.
    pub open_design: &'a Arc<Design>,
    /// File of the open design.
    pub path: Option<&'a Path>,
    /// Whether the open design has unsaved changes.
    pub is_dirty: bool,
    /// Label of the step that an undo undoes.
    pub undoes: Option<&'a str>,
    /// Label of the step that a redo redoes.
    pub redoes: Option<&'a str>,
    /// Preview of a mask of the run.
    pub preview: MaskPreview,
    /// Whether the live estimate is switched on.
    pub is_live: bool,
    /// Results as of this frame.
    pub live: &'a Live,
    /// Longer estimates as of this frame.
    pub estimates: &'a Estimates,
    /// Reconstructions as of this frame.
    pub reconstructions: &'a Reconstructions,
    /// The training of a network, and the trained networks, as of this frame.
    pub trainings: &'a Trainings,
    /// The study as of this frame.
    pub study: &'a StudyView,
    /// Calibration, captures and comparison of cameras as of this frame.
    pub cameras: &'a CameraResults,
    /// The newest capture of a camera as of this frame.
    pub capture: Option<&'a CaptureReconstruction>,
    /// The run that optimizes the mask, as of this frame.
    pub run: Option<&'a DesignRun>,
    /// Key of the last requested inspection of the shown measurement.
    pub inspected: Option<InspectionKey>,
    /// Locked lenslets.
    pub locks: &'a Locks,
    /// Preferences of the user.
    pub preferences: &'a Preferences,
    /// Colours of all maps.
    pub palettes: &'a ColourPalettes,
    /// Facts from the states of panels.
    pub shared: SharedByPanels,
}

/// Preview of a mask of the run.
#[derive(Clone, Copy, Debug)]
pub struct MaskPreview {
    /// Whether a mask of the run is shown in place of the open design.
    pub is_shown: bool,
    /// Whether masks of the run are shown as they come.
    pub is_following: bool,
    /// Whether the shown lenslets are those of the open design, at most moved.
    pub has_own_lenslets: bool,
}

/// Facts from the states of panels that other panels and dialogs read.
pub struct SharedByPanels {
    /// The shown sample.
    pub sample: ShownSample,
    /// Colours of information maps.
    pub map_colours: Colormap,
    /// The run of the chosen result; the last run if none was chosen.
    pub chosen_run: Option<Arc<DesignRun>>,
    /// Whether the mask shows the trajectories of lenslets.
    pub trajectories: bool,
    /// Whether lenslets are selected.
    pub has_selection: bool,
    /// Whether a run can be started.
    pub can_start_run: bool,
    /// Number of snapshots.
    pub snapshots: usize,
}

impl SharedByPanels {
    /// The facts as of now.
    pub fn of(panels: &Panels, open_design: &Design, run: Option<&DesignRun>) -> Self {
        let OptimizeState { chosen, trajectories, .. } = &panels.optimize;
        Self {
            sample: panels.samples.shown,
            map_colours: panels.map.image.colormap,
            chosen_run: chosen.clone(),
            trajectories: *trajectories,
            has_selection: !panels.selection.indices().is_empty(),
            can_start_run: panels.optimize.can_start(open_design, run),
            snapshots: panels.compare.snapshots.entries.len(),
        }
    }
}

impl View<'_> {
    /// Whether an action is available.
    pub fn can_do(&self, action: Action) -> bool {
        match action {
            Action::Undo => self.undoes.is_some(),
            Action::Redo => self.redoes.is_some(),
            Action::SelectAll | Action::AddLenslet => self.lenslet_count() > 0,
            Action::StartRun => self.shared.can_start_run,
            Action::StopRun => self.run.is_some_and(DesignRun::is_active),
            Action::Accept | Action::OpenMask | Action::EndPreview => self.preview.is_shown,
            Action::Delete => self.shared.has_selection,
            Action::RecallLayout(number) => self.preferences.layouts.contains_key(&number),
            Action::FitLenslets => !self.preview.is_shown && self.design.encoder.lenslets().is_none(),
            Action::ExportMeasurements => self.current_measurements().is_some(),
            Action::ExportLive => self.live_estimate().is_some(),
            _ => true,
        }
    }

    /// Whether a result of this revision is current.
    pub fn is_current(&self, revision: u64) -> bool {
        revision == self.revision
    }

    /// Number of lenslets of the shown design.
    pub fn lenslet_count(&self) -> usize {
        self.design.encoder.lenslets().map_or(0, |array| array.lenslets.len())
    }

    /// Whether a lenslet of the shown design is locked.
    pub fn is_locked(&self, index: usize) -> bool {
        self.locks.indices().contains(&index) && self.preview.has_own_lenslets
    }

    /// The live estimate, if it belongs to the current revision.
    pub fn live_estimate(&self) -> Option<&LiveEstimate> {
        let live = self.estimates.live.as_ref()?;
        Some(&*live.value).filter(|_| self.is_current(live.revision))
    }

    /// The measurements, if they belong to the current revision.
    pub fn current_measurements(&self) -> Option<&Revisioned<Measurements>> {
        self.live.measurements.as_ref().filter(|measurements| self.is_current(measurements.revision))
    }

    /// Reason why the current revision has no results, if it failed.
    pub fn failure(&self) -> Option<&str> {
        let (revision, failure) = self.live.failure.as_ref()?;
        self.is_current(*revision).then_some(failure.as_str())
    }

    /// Whether an estimate or a run pauses the live estimate.
    pub fn is_live_paused(&self) -> bool {
        self.estimates.running.is_some() || self.run.is_some_and(|run| run.status == RunStatus::Running)
    }

    /// The run whose trajectories the mask shows.
    pub fn run_with_trajectories(&self) -> Option<&DesignRun> {
        self.shared.chosen_run.as_deref().or(self.run).filter(|_| self.shared.trajectories)
    }

    /// Record from which the live estimate is reproduced.
    pub fn live_record(&self) -> Option<LiveRecord> {
        let scene = self.live.scene.as_ref().filter(|scene| scene.value.serves(self.design))?;
        Some(LiveRecord::new(self.design, &scene.value, self.live_estimate()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Diffuser, Encoder};

    /// A window without a session.
    #[derive(Default)]
    struct Window {
        design: Arc<Design>,
        revision: u64,
        live: Live,
        estimates: Estimates,
        reconstructions: Reconstructions,
        trainings: Trainings,
        study: StudyView,
        cameras: CameraResults,
        locks: Locks,
        preferences: Preferences,
        palettes: ColourPalettes,
        panels: Panels,
    }

    impl Window {
        fn view(&self) -> View<'_> {
            View {
                design: &self.design,
                revision: self.revision,
                open_design: &self.design,
                path: None,
                is_dirty: false,
                undoes: None,
                redoes: None,
                preview: MaskPreview { is_shown: false, is_following: false, has_own_lenslets: true },
                is_live: true,
                live: &self.live,
                estimates: &self.estimates,
                reconstructions: &self.reconstructions,
                trainings: &self.trainings,
                study: &self.study,
                cameras: &self.cameras,
                capture: None,
                run: None,
                inspected: None,
                locks: &self.locks,
                preferences: &self.preferences,
                palettes: &self.palettes,
                shared: SharedByPanels::of(&self.panels, &self.design, None),
            }
        }
    }

    #[test]
    fn actions_on_lenslets_need_lenslets() {
        let can = |window: &Window| {
            [Action::SelectAll, Action::Delete, Action::StartRun, Action::FitLenslets]
                .map(|action| window.view().can_do(action))
        };
        let mut window = Window::default();
        assert_eq!(can(&window), [true, false, true, false]);
        window.panels.selection.set([2]);
        assert_eq!(can(&window), [true, true, true, false]);
        let encoder = Encoder::Diffuser(Diffuser::with_light_kept(8, 1));
        window = Window { design: Arc::new(Design { encoder, ..Design::default() }), ..Window::default() };
        assert_eq!(can(&window), [false, false, false, true]);
    }

    #[test]
    fn failure_of_an_earlier_revision_is_not_shown() {
        let failure = Some((3, "no objects".to_owned()));
        let mut window = Window { revision: 3, live: Live { failure, ..Live::default() }, ..Window::default() };
        assert_eq!(window.view().failure(), Some("no objects"));
        window.revision = 4;
        assert_eq!(window.view().failure(), None);
    }

    #[test]
    fn locks_of_the_design_do_not_hold_for_other_lenslets() {
        let mut window = Window::default();
        window.locks.toggle(&[1].into());
        let mut view = window.view();
        assert!(view.is_locked(1) && !view.is_locked(2));
        view.preview = MaskPreview { is_shown: true, is_following: true, has_own_lenslets: false };
        assert!(!view.is_locked(1));
    }
}
