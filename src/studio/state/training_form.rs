//! The form of a training in the Reconstruction panel.

use crate::reconstruction::TrainingBudget;
use crate::workbench::TrainingScope;

/// A curve of a training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrainingCurve {
    /// Loss of training objects.
    Loss,
    /// PSNR of validation objects.
    Psnr,
}

/// The form of a training.
pub struct TrainingForm {
    /// Masks of the network.
    pub scope: TrainingScope,
    /// Whether the budget is a number of steps.
    pub by_steps: bool,
    /// Budget of work, seconds.
    pub seconds: f64,
    /// Budget in steps.
    pub steps: usize,
    /// Whether the curves of the training are shown in place of the image.
    pub curves: bool,
    /// The curve that is shown where there is room for one.
    pub curve: TrainingCurve,
    /// Whether a training was active in the last frame.
    was_active: bool,
}

impl Default for TrainingForm {
    fn default() -> Self {
        Self {
            scope: TrainingScope::ThisMask,
            by_steps: false,
            seconds: 60.0,
            steps: 500,
            curves: false,
            curve: TrainingCurve::Loss,
            was_active: false,
        }
    }
}

impl TrainingForm {
    /// Shows the curves when a training begins, and the image when it ends.
    pub fn follow(&mut self, is_active: bool) {
        if is_active != self.was_active {
            self.curves = is_active;
        }
        self.was_active = is_active;
    }

    /// When training ends.
    pub fn budget(&self) -> TrainingBudget {
        if self.by_steps { TrainingBudget::Steps(self.steps) } else { TrainingBudget::Seconds(self.seconds) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_come_and_go_with_the_training_unless_switched() {
        let mut form = TrainingForm::default();
        let mut after = |is_active: bool| {
            form.follow(is_active);
            form.curves
        };
        assert!(!after(false) && after(true) && after(true) && !after(false));
        form.follow(true);
        form.curves = false;
        form.follow(true);
        assert!(!form.curves, "the choice of a person stays");
        form.by_steps = true;
        assert_eq!(form.budget(), TrainingBudget::Steps(500));
    }
}
