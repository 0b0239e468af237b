//! A program killed at any moment leaves whole files, and unsaved work can be recovered. The recovered state is a recent
//! state of the design.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command as Process, Stdio};
use std::sync::mpsc::channel;

use lenslet_studio::forward::Design;
use lenslet_studio::optics::Lenslet;
use lenslet_studio::workbench::{Command, LensletChange, Outcome, Recovered, Session};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Variables of the child: its folder, the number of its first edit, and the number of edits between saves, 0 for never.
const FOLDER: &str = "LENSLET_STUDIO_CRASH_FOLDER";
const FIRST: &str = "LENSLET_STUDIO_CRASH_FIRST_EDIT";
const SAVES: &str = "LENSLET_STUDIO_CRASH_SAVES";
const SAVED_FILE: &str = "design.json";
/// Most steps of the child, edits and saves, from its first one to its end.
const STEPS: usize = 40;

/// The edited lenslet after the edit of this number. No two are equal.
fn edited(edit: u64) -> Lenslet {
    let lenslet = Design::default().encoder.lenslets().unwrap().lenslets[0];
    Lenslet { x: 4.0 + (edit % 200) as f64 * 0.1, y: 4.0 + (edit / 200) as f64 * 0.1, ..lenslet }
}

fn command(edit: u64) -> Command {
    Command::ChangeLenslets { what: LensletChange::Position, lenslets: vec![(0, edited(edit))] }
}

/// Number of the edit that produced a design. The design must be equal in every other respect.
fn edit_of(design: &Design) -> u64 {
    let lenslet = design.encoder.lenslets().unwrap().lenslets[0];
    let edit = ((lenslet.x - 4.0) * 10.0).round() as u64 + 200 * ((lenslet.y - 4.0) * 10.0).round() as u64;
    assert_eq!(*design, command(edit).applied_to(&Design::default()).unwrap(), "edit {edit}");
    edit
}

/// Edits and saves without end, an edit for each piece of news, and writes its steps to the standard error. It does nothing unless a test
/// below starts it.
#[test]
fn edits_and_saves_until_it_is_killed() {
    let Some(folder) = std::env::var_os(FOLDER).map(PathBuf::from) else { return };
    let number = |name: &str| std::env::var(name).unwrap().parse::<u64>().unwrap();
    let (first, saves) = (number(FIRST), number(SAVES));
    let (wake, news) = channel();
    let mut session = Session::new(Design::default(), None, move || wake.send(()).unwrap_or_default()).unwrap();
    session.set_live(false);
    session.keep_unsaved_in(&folder.join("unsaved")).unwrap();
    // One write each, so a kill leaves whole lines.
    let announce = |kind: &str, edit: u64| std::io::stderr().write_all(format!("{kind} {edit}\n").as_bytes()).unwrap();
    let (mut saving, mut seen) = (VecDeque::new(), None);
    for edit in first.. {
        announce("edit", edit);
        session.apply(&command(edit)).unwrap();
        assert_eq!(session.note_unsaved(), None);
        if saves > 0 && edit % saves == saves - 1 {
            session.save_to(folder.join(SAVED_FILE));
            saving.push_back(edit);
        }
        news.recv().unwrap();
        for outcome in session.take_outcomes() {
            assert!(matches!(outcome.unwrap(), Outcome::Saved { .. }));
            announce("saved", saving.pop_front().unwrap());
        }
        // Without saves the autosaved design never goes back.
        if saves == 0 && kept(&folder) != seen {
            let before = std::mem::replace(&mut seen, kept(&folder));
            assert!(seen > before, "{seen:?} after {before:?}");
            announce("kept", seen.unwrap());
        }
    }
}

/// Newest steps of all children so far.
#[derive(Clone, Copy, Default)]
struct Steps {
    edit: Option<u64>,
    saved: Option<u64>,
    kept: Option<u64>,
}

/// The program to be killed, even if the test fails, and the lines that it writes.
struct Victim {
    child: Child,
    lines: BufReader<ChildStderr>,
}

impl Victim {
    fn start(folder: &Path, first: u64, saves: u64) -> Self {
        let mut child = Process::new(std::env::current_exe().unwrap())
            .args(["crash::edits_and_saves_until_it_is_killed", "--exact", "--nocapture"])
            .env(FOLDER, folder)
            .env(FIRST, first.to_string())
            .env(SAVES, saves.to_string())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stderr.take().unwrap());
        Self { child, lines }
    }

    /// Waits for the next step and notes it. None after the last one.
    fn step(&mut self, steps: &mut Steps) -> Option<String> {
        let mut line = String::new();
        self.lines.read_line(&mut line).unwrap();
        let (kind, edit) = line.trim_end().split_once(' ')?;
        let edit: u64 = edit.parse().unwrap_or_else(|_| panic!("{line}"));
        match kind {
            "edit" => steps.edit = Some(edit),
            "saved" => steps.saved = Some(edit),
            "kept" => steps.kept = Some(edit),
            _ => panic!("{line}"),
        }
        Some(kind.into())
    }

    /// Waits for the next step of a kind.
    fn until(&mut self, kind: &str, steps: &mut Steps) {
        while self.step(steps).expect("it ends only when it is killed") != kind {}
    }

    /// Kills it and notes its last steps.
    fn kill(mut self, steps: &mut Steps) {
        assert!(self.child.try_wait().unwrap().is_none(), "it ends only when it is killed");
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        while self.step(steps).is_some() {}
    }
}

impl Drop for Victim {
    fn drop(&mut self) {
        // It may have ended by itself, which is reported where it matters.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Files with unsaved changes.
fn unsaved(folder: &Path) -> Vec<PathBuf> {
    let Ok(files) = std::fs::read_dir(folder.join("unsaved")) else { return Vec::new() };
    let files = files.map(|file| file.unwrap().path());
    files.filter(|file| file.extension().is_some_and(|ending| ending == "json")).collect()
}

/// Designs that the window offers when it is opened next.
fn offered(folder: &Path) -> Vec<Recovered> {
    let left = unsaved(folder).len();
    let mut session = Session::new(Design::default(), None, || {}).unwrap();
    session.set_live(false);
    let found = session.keep_unsaved_in(&folder.join("unsaved")).unwrap();
    assert_eq!(found.len(), left, "every file that was left behind is whole");
    found
}

/// The autosaved edit while its program runs.
fn kept(folder: &Path) -> Option<u64> {
    let files = unsaved(folder);
    assert!(files.len() <= 1, "{files:?}");
    let value: serde_json::Value = serde_json::from_slice(&std::fs::read(files.first()?).unwrap()).unwrap();
    Some(edit_of(&serde_json::from_value(value["design"].clone()).unwrap()))
}

/// Kills as many programs, each at a random step.
fn kill_many(kills: usize) {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let (mut saved, mut recovered) = (0, 0);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(SAVED_FILE);
    let mut steps = Steps::default();
    for kill in 0..kills {
        let first = steps.edit.map_or(0, |edit| edit + 1);
        let mut victim = Victim::start(folder.path(), first, 3);
        // One in eight is killed while it starts, whenever that happens on this machine.
        if kill % 8 != 0 {
            // One in eight has saved, even if that takes long on a busy disk.
            victim.until(if kill % 8 == 1 { "saved" } else { "edit" }, &mut steps);
            for _ in 0..random.random_range(0..STEPS) {
                victim.step(&mut steps).expect("it ends only when it is killed");
            }
        }
        // Writes go on in other threads meanwhile.
        victim.kill(&mut steps);
        if file.exists() {
            let edit = edit_of(&Design::open(&file).unwrap());
            assert!(Some(edit) >= steps.saved && Some(edit) <= steps.edit, "{edit} of {:?}", steps.edit);
            saved += 1;
        }
        for left in offered(folder.path()) {
            let edit = edit_of(&left.design);
            assert!(edit >= first && Some(edit) <= steps.edit, "{edit} of {first} to {:?}", steps.edit);
            assert!(left.path.as_ref().is_none_or(|path| *path == file));
            left.discard();
            recovered += 1;
        }
    }
    assert!(saved > kills / 2 && recovered > 0, "{saved} saved, {recovered} recovered");
}

#[test]
fn no_kill_tears_a_file_or_loses_what_was_kept() {
    kill_many(16);
}

#[test]
#[ignore = "kills 400 programs, which takes a minute or more; run with --ignored"]
fn none_of_many_kills_tears_a_file() {
    kill_many(400);
}

/// Kills a program after its autosaved design was written so many times, some seconds apart, and recovers it.
fn kill_after_autosaves(times: usize) {
    let folder = tempfile::tempdir().unwrap();
    let mut victim = Victim::start(folder.path(), 0, 0);
    let mut steps = Steps::default();
    for _ in 0..times {
        let before = steps;
        victim.until("kept", &mut steps);
        // While edits go on, each file is of an edit since the file before.
        assert!(steps.kept > before.kept && steps.kept <= steps.edit, "{:?} of {:?}", steps.kept, steps.edit);
    }
    victim.kill(&mut steps);
    let mut found = offered(folder.path());
    let edit = found.pop().map(|left| edit_of(&left.design));
    let Steps { kept, edit: newest, .. } = steps;
    assert!(found.is_empty() && edit >= kept && edit <= newest, "{edit:?}, but {kept:?} was kept of {newest:?}");
}

#[test]
fn what_was_kept_is_recovered() {
    kill_after_autosaves(1);
}

#[test]
#[ignore = "takes a quarter of a minute; run with --ignored"]
fn autosave_keeps_up_with_continuous_edits() {
    kill_after_autosaves(4);
}
