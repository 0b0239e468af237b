//! A program killed at any moment leaves whole files, and unsaved work can be recovered. The recovered state is a recent
//! state of the design.

use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Process, Stdio};
use std::time::{Duration, Instant};

use lenslet_studio::forward::Design;
use lenslet_studio::optics::Lenslet;
use lenslet_studio::workbench::{Command, LensletChange, Outcome, Recovered, Session};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Variables of the child: its folder, the number of its first edit, and the number of edits between saves, 0 for never.
const FOLDER: &str = "LENSLET_STUDIO_CRASH_FOLDER";
const FIRST: &str = "LENSLET_STUDIO_CRASH_FIRST_EDIT";
const SAVES: &str = "LENSLET_STUDIO_CRASH_SAVES";
const KILLS: usize = 200;
/// File in which the child announces its next step.
const JOURNAL: &str = "journal";
const SAVED_FILE: &str = "design.json";
/// Largest allowed delay of the autosaved design behind the open one.
const PROMISED: Duration = Duration::from_secs(30);

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

/// Edits and saves without end. It does nothing unless a test below starts it.
#[test]
fn edits_and_saves_until_it_is_killed() {
    let Some(folder) = std::env::var_os(FOLDER).map(PathBuf::from) else { return };
    let number = |name: &str| std::env::var(name).unwrap().parse::<u64>().unwrap();
    let (first, saves) = (number(FIRST), number(SAVES));
    let mut session = Session::new(Design::default(), None, || {}).unwrap();
    session.set_live(false);
    session.keep_unsaved_in(&folder.join("unsaved")).unwrap();
    let mut journal = File::options().append(true).create(true).open(folder.join(JOURNAL)).unwrap();
    let mut saving = VecDeque::new();
    for edit in first.. {
        // One write each, so a kill leaves whole lines.
        journal.write_all(format!("edit {edit}\n").as_bytes()).unwrap();
        session.apply(&command(edit)).unwrap();
        assert_eq!(session.note_unsaved(), None);
        if saves > 0 && edit % saves == saves - 1 {
            session.save_to(folder.join(SAVED_FILE));
            saving.push_back(edit);
        }
        for outcome in session.take_outcomes() {
            assert!(matches!(outcome.unwrap(), Outcome::Saved { .. }));
            journal.write_all(format!("saved {}\n", saving.pop_front().unwrap()).as_bytes()).unwrap();
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// The program to be killed, even if the test fails.
struct Victim(Child);

impl Victim {
    fn start(folder: &Path, first: u64, saves: u64) -> Self {
        let child = Process::new(std::env::current_exe().unwrap())
            .args(["crash::edits_and_saves_until_it_is_killed", "--exact", "--nocapture"])
            .env(FOLDER, folder)
            .env(FIRST, first.to_string())
            .env(SAVES, saves.to_string())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        Self(child.unwrap())
    }

    fn kill(mut self) {
        assert!(self.0.try_wait().unwrap().is_none(), "it ends only when it is killed");
    }
}

impl Drop for Victim {
    fn drop(&mut self) {
        // It may have ended by itself, which is reported where it matters.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The last number of this kind in the journal.
fn last(folder: &Path, kind: &str) -> Option<u64> {
    let journal = std::fs::read_to_string(folder.join(JOURNAL)).unwrap_or_default();
    // A line that is being written has no end yet.
    let mut lines = journal.split_inclusive('\n').filter(|line| line.ends_with('\n'));
    lines.rfind(|line| line.starts_with(kind))?[kind.len()..].trim().parse().ok()
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

#[test]
fn no_kill_tears_a_file_or_loses_what_was_kept() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let (mut saved, mut recovered) = (0, 0);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(SAVED_FILE);
    for kills in 0..KILLS {
        let first = last(folder.path(), "edit").map_or(0, |edit| edit + 1);
        let victim = Victim::start(folder.path(), first, 3);
        // A few are killed while they start, whenever that happens on this machine.
        for _ in 0..20_000 {
            // One in eight has saved, even if that takes long on a busy disk.
            let kind = if kills % 8 == 1 { "saved" } else { "edit" };
            if kills % 8 == 0 || last(folder.path(), kind) >= Some(first) {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_micros(random.random_range(0..80_000)));
        victim.kill();
        let newest = last(folder.path(), "edit");
        if file.exists() {
            let edit = edit_of(&Design::open(&file).unwrap());
            assert!(Some(edit) >= last(folder.path(), "saved") && Some(edit) <= newest, "{edit} of {newest:?}");
            saved += 1;
        }
        for left in offered(folder.path()) {
            let edit = edit_of(&left.design);
            assert!(edit >= first && Some(edit) <= newest, "{edit} of {first} to {newest:?}");
            assert!(left.path.as_ref().is_none_or(|path| *path == file));
            left.discard();
            recovered += 1;
        }
    }
    assert!(saved > KILLS / 2 && recovered > 0, "{saved} saved, {recovered} recovered");
}

/// The autosaved edit while its program runs.
fn kept(folder: &Path) -> Option<u64> {
    let files = unsaved(folder);
    assert!(files.len() <= 1, "{files:?}");
    let value: serde_json::Value = serde_json::from_slice(&std::fs::read(files.first()?).unwrap()).unwrap();
    Some(edit_of(&serde_json::from_value(value["design"].clone()).unwrap()))
}

#[test]
fn what_is_recovered_is_no_older_than_promised() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let victim = Victim::start(folder, 0, 0);
    let begun = Instant::now();
    while last(folder, "edit").is_none() {
        assert!(begun.elapsed() < PROMISED, "it does not start");
        std::thread::sleep(Duration::from_millis(1));
    }
    // During continuous editing the autosaved design keeps up.
    let mut seen = None;
    for _ in 0..2 {
        let (now, asked) = (last(folder, "edit"), Instant::now());
        while seen < now {
            assert!(asked.elapsed() < PROMISED, "{now:?} is not kept, but {seen:?} is");
            let later = kept(folder);
            assert!(later >= seen, "{later:?} after {seen:?}");
            seen = later;
            std::thread::sleep(Duration::from_millis(2));
        }
    }
    victim.kill();
    let mut found = offered(folder);
    let edit = found.pop().map(|left| edit_of(&left.design));
    assert!(found.is_empty() && edit >= seen && edit <= last(folder, "edit"), "{edit:?}, but {seen:?} was kept");
}
