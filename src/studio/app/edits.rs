//! Edits of the design, and what follows from them for selection, drag and locks.

use crate::optics::{Encoder, Lenslet, depth_layout, heuristic_layout, random_layout};
use crate::plural::counted;
use crate::studio::app::state::State;
use crate::studio::state::action::Preset;
use crate::studio::state::messages::Severity;
use crate::studio::widgets::number_field::Edit;
use crate::workbench::{Command, Session};

impl State {
    /// Applies a command to the design; a message reports a refusal.
    pub fn send(&mut self, command: &Command) {
        let are_others = !self.session.shows_own_lenslets();
        if let Err(error) = self.session.apply(command) {
            return self.messages.push(Severity::Failure, error.to_string());
        }
        match command {
            Command::AddLenslet(_) => self.panels.selection.set(self.lenslet_count().checked_sub(1)),
            Command::DeleteLenslets(_) | Command::ReplaceEncoder { .. } | Command::ReplaceDesign { .. } => {
                self.panels.selection.clear();
                self.panels.mask.drag = None; // its indices now belong to other lenslets
            }
            _ => {}
        }
        match (are_others, command.edits_mask()) {
            // An edit of a previewed mask accepts it.
            (true, true) => self.locks.check(self.session.lenslets()),
            // The preview has ended.
            (true, false) => self.panels.selection.clear(),
            (false, _) => {}
        }
        self.locks.follow(command, self.session.lenslets());
    }

    /// Applies a command of a number field; a typed number is one undo step.
    pub fn send_edit(&mut self, edit: Edit, command: &Command) {
        if edit.is_typed {
            self.session.begin_step();
        }
        self.send(command);
        if edit.is_typed {
            self.session.begin_step();
        }
    }

    /// Switches to another design, as by undo. Drag, selection and locks are reset if its lenslets differ.
    pub fn go(&mut self, go: impl FnOnce(&mut Session)) {
        let shown = |session: &Session| (session.lenslets(), session.shows_own_lenslets());
        let before = shown(&self.session);
        go(&mut self.session);
        self.panels.mask.drag = None;
        if shown(&self.session) != before {
            self.panels.selection.clear();
        }
        self.locks.check(self.session.lenslets());
    }

    /// Number of lenslets of the shown design.
    pub fn lenslet_count(&self) -> usize {
        self.session.design().encoder.lenslets().map_or(0, |array| array.lenslets.len())
    }

    /// Adds a copy of the last lenslet in the middle of the grid.
    pub fn add_lenslet(&mut self) {
        let Some(array) = self.session.design().encoder.lenslets() else { return };
        let (x, y) = ((array.cols / 2) as f64, (array.rows / 2) as f64);
        let like = array.lenslets.last();
        let sigma = like.map_or(crate::optics::HEURISTIC_SIGMA, |lenslet| lenslet.spot.mean_sigma());
        let weight = like.map_or(1.0, |lenslet| lenslet.weight.max(1e-3));
        self.send(&Command::AddLenslet(Lenslet::round(x, y, sigma, weight)));
    }

    /// Deletes the selected lenslets.
    pub fn delete_selection(&mut self) {
        let indices: Vec<usize> = self.panels.selection.indices().iter().copied().collect();
        if !indices.is_empty() {
            self.send(&Command::DeleteLenslets(indices));
        }
    }

    /// Replaces the mask by a preset.
    pub fn put_preset(&mut self, preset: Preset) {
        let design = self.session.design();
        let (seed, (rows, cols)) = (design.seed, design.encoder.grid());
        let (name, encoder) = match preset {
            Preset::Heuristic(count) => {
                (counted(count, "heuristic lenslet"), Encoder::Lenslets(heuristic_layout(count)))
            }
            Preset::Random => {
                // The seed of the design first, then consecutive ones.
                let draw = self.random_start.map_or(seed, |last| last.wrapping_add(1));
                self.random_start = Some(draw);
                (format!("25 random lenslets, seed {draw}"), Encoder::Lenslets(random_layout(25, draw)))
            }
            Preset::Depth => ("5 lenslets in depth".into(), Encoder::Lenslets(depth_layout(5, 5))),
            Preset::Diffuser(aperture_px) => return self.session.make_diffuser(aperture_px),
        };
        // The sensor keeps its size.
        let Some(encoder) = encoder.on_grid(rows, cols) else { return };
        self.send(&Command::ReplaceEncoder { name, encoder });
    }

    /// Opens a snapshot in place of the design; its numbers keep improving while it is open.
    pub fn open_snapshot(&mut self, number: u64) {
        let Some(snapshot) = self.panels.compare.snapshots.get(number) else { return };
        let command = Command::ReplaceDesign { name: snapshot.name.clone(), design: snapshot.design.clone() };
        self.send(&command);
        let revision = self.session.revision();
        let entries = &mut self.panels.compare.snapshots.entries;
        if let Some(snapshot) = entries.iter_mut().find(|snapshot| snapshot.number == number) {
            snapshot.is_open_as(revision);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::forward::Design;
    use crate::optics::Diffuser;
    use crate::studio::state::mask::MaskDrag;

    /// The state in the first frame.
    fn window() -> State {
        let mut state = State::new(Session::new(Design::default(), None, || {}).unwrap());
        state.load_results();
        state
    }

    #[test]
    fn new_lenslet_is_selected() {
        let mut state = window();
        state.panels.selection.set([1, 2]);
        state.add_lenslet();
        assert_eq!(*state.panels.selection.indices(), BTreeSet::from([9]));
    }

    #[test]
    fn deletion_ends_drag_and_selection_and_undo_restores_locks() {
        let mut state = window();
        state.locks.toggle(&BTreeSet::from([1, 4]));
        state.panels.selection.set([1]);
        state.panels.mask.drag = Some(MaskDrag::Select { start: (0.0, 0.0), before: BTreeSet::new() });
        state.delete_selection();
        assert_eq!(*state.locks.indices(), BTreeSet::from([3]), "indices count the lenslets that are left");
        assert!(state.panels.mask.drag.is_none() && state.panels.selection.indices().is_empty());
        state.go(Session::undo);
        assert_eq!(*state.locks.indices(), BTreeSet::from([1, 4]));
    }

    #[test]
    fn refused_command_is_reported() {
        let mut state = window();
        state.send(&Command::DeleteLenslets(vec![9]));
        assert_eq!(state.messages.failure.as_deref(), Some("there is no lenslet 10; the mask has 9"));
    }

    /// Waits for the job of a window without frames.
    fn finish_job(state: &mut State) -> Vec<Result<crate::workbench::Outcome, String>> {
        loop {
            let outcomes = state.session.take_outcomes();
            if !outcomes.is_empty() {
                return outcomes;
            }
            std::thread::yield_now();
        }
    }

    #[test]
    fn diffusers_are_made_by_the_worker_and_later_edits_stay() {
        let mut state = window();
        let before = state.session.design().encoder.clone();
        state.put_preset(Preset::Diffuser(16));
        assert_eq!(state.session.design().encoder, before, "the worker makes it");
        state.send(&Command::SetMeanPhotons(7.0));
        let refused = finish_job(&mut state);
        assert!(matches!(&refused[..], [Err(sentence)] if sentence.contains("changed meanwhile")), "{refused:?}");
        assert_eq!(state.session.design().encoder, before);
        state.put_preset(Preset::Diffuser(16));
        assert!(finish_job(&mut state)[0].is_ok());
        let diffuser = Diffuser::behind_aperture(16, state.session.design().seed);
        assert_eq!(state.session.design().encoder, Encoder::Diffuser(diffuser));
        assert_eq!(state.session.undoes(), Some("Use diffuser, aperture 16 px"));
    }

    #[test]
    fn the_worker_sets_the_grid_of_a_diffuser() {
        let mut state = window();
        let diffuser = Diffuser::behind_aperture(16, 4);
        state.send(&Command::ReplaceEncoder { name: "diffuser".into(), encoder: Encoder::Diffuser(diffuser) });
        state.session.resize_diffuser(48);
        assert_eq!(state.session.design().encoder.grid(), (32, 32));
        assert!(finish_job(&mut state)[0].is_ok());
        assert_eq!(state.session.design().encoder, Encoder::Diffuser(diffuser.on_grid(48)));
        assert_eq!(state.session.undoes(), Some("Use diffuser on a grid of 48 px"));
    }

    #[test]
    fn random_presets_have_consecutive_seeds() {
        let mut state = window();
        let seed = state.session.design().seed;
        for draw in [seed, seed + 1] {
            state.put_preset(Preset::Random);
            assert_eq!(state.session.design().encoder, Encoder::Lenslets(random_layout(25, draw)));
        }
    }
}
