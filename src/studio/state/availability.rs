//! Availability of actions.

use crate::studio::state::action::Action;
use crate::studio::state::app_state::State;
use crate::workbench::DesignRun;

impl State {
    /// Whether an action is available.
    pub fn can_do(&self, action: Action) -> bool {
        match action {
            Action::Undo => self.session.undoes().is_some(),
            Action::Redo => self.session.redoes().is_some(),
            Action::SelectAll | Action::AddLenslet => self.lenslet_count() > 0,
            Action::StartRun => self.can_start_run(),
            Action::StopRun => self.run.as_ref().is_some_and(DesignRun::is_active),
            Action::Accept | Action::OpenMask | Action::EndPreview => self.session.is_previewing(),
            Action::Delete => !self.selection.is_empty(),
            Action::RecallLayout(number) => self.preferences.layouts.contains_key(&number),
            Action::FitLenslets => !self.session.is_previewing() && self.session.design().encoder.lenslets().is_none(),
            Action::ExportMeasurements => self.current_measurements().is_some(),
            Action::ExportLive => self.live_estimate().is_some(),
            _ => true,
        }
    }
}
