//! A program that is killed at any moment leaves whole files, and what was not saved can be recovered.

use std::path::{Path, PathBuf};
use std::process::{Command as Process, Stdio};
use std::time::Duration;

use lenslet_studio::optics::Lenslet;
use lenslet_studio::workbench::{Command, Design, LensletChange, Workbench};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Tells the child where to work.
const FOLDER: &str = "LENSLET_STUDIO_CRASH_FOLDER";
const KILLS: usize = 200;
/// The file that tells that the child edits by now.
const STARTED: &str = "started";

/// Edits and saves without end; does nothing unless it is started by the test below.
#[test]
fn edits_and_saves_until_it_is_killed() {
    let Some(folder) = std::env::var_os(FOLDER).map(PathBuf::from) else { return };
    let mut bench = Workbench::new(Design::default(), None, || {}).unwrap();
    bench.set_live(false);
    bench.keep_unsaved_in(&folder.join("unsaved")).unwrap();
    std::fs::write(folder.join(STARTED), b"").unwrap();
    for edit in 0_u32.. {
        let mut lenslet: Lenslet = bench.design().encoder.lenslets().unwrap().lenslets[0];
        lenslet.x = 4.0 + f64::from(edit % 200) * 0.1;
        bench.apply(&Command::ChangeLenslets { what: LensletChange::Position, lenslets: vec![(0, lenslet)] }).unwrap();
        assert_eq!(bench.note_unsaved(), None);
        if edit % 3 == 2 {
            bench.save_to(folder.join("design.json"));
        }
        for outcome in bench.take_outcomes() {
            outcome.unwrap();
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn unsaved(folder: &Path) -> usize {
    let Ok(files) = std::fs::read_dir(folder.join("unsaved")) else { return 0 };
    files.filter(|file| file.as_ref().unwrap().path().extension().is_some_and(|ending| ending == "json")).count()
}

#[test]
fn no_kill_tears_a_file_or_loses_what_was_kept() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let (mut saved, mut recovered) = (0, 0);
    let folder = tempfile::tempdir().unwrap();
    for kill in 0..KILLS {
        let started = folder.path().join(STARTED);
        let _ = std::fs::remove_file(&started);
        let mut child = Process::new(std::env::current_exe().unwrap())
            .args(["edits_and_saves_until_it_is_killed", "--exact", "--nocapture"])
            .env(FOLDER, folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // A few are killed while they start, whenever that is on this machine.
        for _ in 0..20_000 {
            if kill % 8 == 0 || started.exists() {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_micros(random.random_range(0..80_000)));
        assert!(child.try_wait().unwrap().is_none(), "the child ends only when it is killed");
        child.kill().unwrap();
        child.wait().unwrap();
        let file = folder.path().join("design.json");
        if file.exists() {
            Design::open(&file).unwrap();
            saved += 1;
        }
        // What the window does when it is opened next.
        let offered = unsaved(folder.path());
        let mut bench = Workbench::new(Design::default(), None, || {}).unwrap();
        bench.set_live(false);
        let found = bench.keep_unsaved_in(&folder.path().join("unsaved")).unwrap();
        assert_eq!(found.len(), offered, "every file that was left behind is whole");
        for left in found {
            assert_eq!(left.design.encoder.lenslets().unwrap().lenslets.len(), 9);
            recovered += 1;
            left.discard();
        }
    }
    assert!(saved > KILLS / 2 && recovered > KILLS / 8, "{saved} saved, {recovered} recovered");
}
