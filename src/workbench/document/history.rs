//! Undo and redo: the designs before and after the present one, one step for every gesture.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::forward::Design;

/// Largest number of steps.
const STEPS: usize = 1000;
/// Largest memory of all steps, bytes, roughly.
const BYTES: usize = 256 << 20;
/// Interval within which successive changes of one kind form one step: typed digits, turns of a wheel, keys held down. Held keys repeat
/// after up to most of a second.
const ONE_STEP: Duration = Duration::from_secs(1);

/// A design and the number of its contents; equal numbers mean equal designs.
#[derive(Clone, Debug)]
pub struct Version {
    /// The design.
    pub design: Arc<Design>,
    /// Number of its contents.
    pub number: u64,
    /// Number of its lenslets; equal numbers mean that indices mean the same ones.
    pub lenslets: u64,
}

/// One step back or forth.
#[derive(Clone, Debug)]
struct Step {
    /// Description of the change, for the menu.
    label: String,
    /// The design on the other side of the step.
    version: Version,
}

/// Whether the pointer is held down, and the number of its presses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Pointer {
    down: bool,
    presses: u64,
}

/// Steps back and forth.
#[derive(Debug, Default)]
pub struct History {
    past: Vec<Step>,
    future: Vec<Step>,
    /// The last change: its kind, if a similar one can extend it, its time, and the state of the pointer.
    last: Option<(Option<String>, Instant, Pointer)>,
    pointer: Pointer,
}

impl History {
    /// Notes whether the pointer is held down, and whether it was pressed since the last call, after which it may be up again.
    pub fn note_pointer(&mut self, down: bool, pressed: bool) {
        self.pointer.presses += u64::from(pressed);
        self.pointer.down = down;
    }

    /// Begins a new step for the next change of any kind.
    pub fn begin_step(&mut self) {
        self.last = None;
    }

    /// Notes that the design `before` is about to change. Changes of one kind form one step while the pointer is held down, or in quick
    /// succession without it. A change without a kind is a step of its own.
    pub fn note(&mut self, before: Version, label: String, kind: Option<String>) {
        let now = Instant::now();
        let same = self.last.as_ref().is_some_and(|(last, at, pointer)| {
            // Every click is a gesture of its own, however soon it comes.
            let goes_on = *pointer == self.pointer && (pointer.down || now.duration_since(*at) < ONE_STEP);
            kind.is_some() && *last == kind && goes_on
        });
        self.future.clear();
        if let Some(step) = self.past.last_mut().filter(|_| same) {
            // The label is that of the gesture's latest change.
            step.label = label;
        } else {
            self.past.push(Step { label, version: before });
            self.forget();
        }
        self.last = Some((kind, now, self.pointer));
    }

    /// Removes all steps, for another document.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// The design that an undo restores.
    pub fn before(&self) -> Option<&Arc<Design>> {
        self.past.last().map(|step| &step.version.design)
    }

    /// Description of the change that an undo reverts.
    pub fn undoes(&self) -> Option<&str> {
        self.past.last().map(|step| step.label.as_str())
    }

    /// Description of the change that a redo repeats.
    pub fn redoes(&self) -> Option<&str> {
        self.future.last().map(|step| step.label.as_str())
    }

    /// The design one step back; [`History::redo`] restores `present`.
    pub fn undo(&mut self, present: Version) -> Option<Version> {
        let Step { label, version } = self.past.pop()?;
        self.future.push(Step { label, version: present });
        self.last = None;
        Some(version)
    }

    /// The design one step forward.
    pub fn redo(&mut self, present: Version) -> Option<Version> {
        let Step { label, version } = self.future.pop()?;
        self.past.push(Step { label, version: present });
        self.last = None;
        Some(version)
    }

    /// Drops the oldest steps beyond the limits.
    fn forget(&mut self) {
        let mut bytes = 0;
        let fits = |step: &&Step| {
            bytes += step.version.design.size_in_memory();
            bytes <= BYTES
        };
        let kept = self.past.iter().rev().take(STEPS).take_while(fits).count().max(1);
        self.past.drain(..self.past.len() - kept);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Encoder, PsfImage};

    fn version(number: u64) -> Version {
        let design = Arc::new(Design { seed: number, ..Design::default() });
        Version { design, number, lenslets: 1 }
    }

    #[test]
    fn a_gesture_is_one_step_and_steps_go_both_ways() {
        let mut history = History::default();
        for press in 0..2 {
            history.note_pointer(true, true);
            for number in 0..5 {
                history.note(version(5 * press + number), "Move lenslet".into(), Some("move 1".into()));
            }
            history.note_pointer(false, false);
        }
        history.note(version(10), "Add lenslet".into(), None);
        assert_eq!((history.undoes(), history.redoes()), (Some("Add lenslet"), None));
        assert_eq!(history.undo(version(11)).unwrap().number, 10);
        assert_eq!(history.undo(version(10)).unwrap().number, 5);
        assert_eq!(history.undo(version(5)).unwrap().number, 0);
        assert!(history.undo(version(0)).is_none());
        assert_eq!(history.redoes(), Some("Move lenslet"));
        assert_eq!(history.redo(version(0)).unwrap().number, 5);
        history.note(version(5), "Set seed".into(), Some("seed".into()));
        assert_eq!(history.redoes(), None, "a change after an undo leaves nothing to redo");
    }

    #[test]
    fn clicks_are_steps_of_their_own_and_typed_digits_are_not() {
        let mut history = History::default();
        for number in 0..3 {
            // The last is over within a frame.
            if number < 2 {
                history.note_pointer(true, true);
            }
            history.note_pointer(false, number == 2);
            history.note(version(number), format!("Set seed to {}", number + 1), Some("seed".into()));
        }
        assert_eq!(history.past.len(), 3);
        for (number, typed) in [(3, "2"), (4, "25"), (5, "250")] {
            history.note(version(number), format!("Set mean to {typed} photons"), Some("mean photons".into()));
        }
        assert_eq!((history.past.len(), history.undoes()), (4, Some("Set mean to 250 photons")));
        assert_eq!(history.undo(version(6)).unwrap().number, 3);
        for number in [3, 4] {
            history.note(version(number), "Add lenslet".into(), None);
        }
        assert_eq!(history.past.len(), 5, "however soon they come");
        for number in [5, 6] {
            history.begin_step();
            history.note(version(number), "Set seed".into(), Some("seed".into()));
        }
        assert_eq!(history.past.len(), 7, "by a button, too");
    }

    #[test]
    fn the_oldest_steps_are_forgotten() {
        let mut history = History::default();
        for number in 0..STEPS as u64 + 50 {
            history.note(version(number), "Set seed".into(), Some(number.to_string()));
        }
        assert_eq!(history.past.len(), STEPS);
        assert_eq!(history.past[0].version.number, 50);
    }

    #[test]
    fn large_steps_stay_within_their_memory_and_the_newest_can_be_undone() {
        const SIDE: usize = 1024;
        let imaged = |number: u64| {
            let mut psf = ndarray::Array2::zeros((SIDE, SIDE));
            psf[(number as usize, 0)] = 1.0;
            let encoder =
                Encoder::Image(PsfImage { psf, origin: "camera.tiff".into(), throughput: 1.0, photograph: None });
            Version { design: Arc::new(Design { encoder, ..Design::default() }), number, lenslets: 1 }
        };
        let takes = |steps: &[Step]| steps.len() * SIDE * SIDE * size_of::<f32>();
        // Twice the memory limit.
        let count = (2 * BYTES / (SIDE * SIDE * size_of::<f32>())) as u64;
        let mut history = History::default();
        for number in 0..count {
            history.note(imaged(number), format!("Import {number}"), None);
            assert!(takes(&history.past) <= BYTES);
            assert_eq!(history.undoes(), Some(&*format!("Import {number}")));
        }
        let kept = history.past.len() as u64;
        assert!(kept > count / 4 && kept < count, "{kept} of {count}");
        let mut present = imaged(count);
        for number in (count - kept..count).rev() {
            present = history.undo(present).unwrap();
            assert_eq!(present.number, number);
            assert!(present.design == imaged(number).design, "{number} comes back as it was");
            assert!(takes(&history.past) + takes(&history.future) <= BYTES);
        }
        assert!(history.undo(present.clone()).is_none(), "what is older is gone");
        for number in count - kept + 1..=count {
            present = history.redo(present).unwrap();
            assert!(present.number == number && present.design == imaged(number).design);
        }
    }
}
