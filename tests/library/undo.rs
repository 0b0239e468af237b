//! Undo and redo of whole designs, and files that arrive after their design has changed.

use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use lenslet_studio::forward::Design;
use lenslet_studio::objects::ObjectSource;
use lenslet_studio::optics::{Encoder, Lenslet, heuristic_layout};
use lenslet_studio::sensor::Noise;
use lenslet_studio::workbench::{Command, LensletChange, Outcome, Session};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// One action of a user.
#[derive(Clone, Debug)]
struct Deed {
    kind: u8,
    place: (f64, f64),
    index: usize,
    /// Whether the pointer is held down afterwards.
    down: bool,
}

fn deeds() -> impl Strategy<Value = Vec<Deed>> {
    let deed = (0..11_u8, (0.0..31.0, 0.0..31.0), 0..40_usize, any::<bool>());
    prop::collection::vec(deed.prop_map(|(kind, place, index, down)| Deed { kind, place, index, down }), 1..60)
}

/// Command of the action for this design. Some commands are refused, such as deleting the last lenslet.
fn command(deed: &Deed, design: &Design) -> Command {
    let (x, y) = deed.place;
    let lenslets = design.encoder.lenslets().map_or(&[][..], |array| &array.lenslets);
    let index = deed.index % lenslets.len().max(1);
    let old = lenslets.get(index).copied().unwrap_or(Lenslet::round(x, y, 1.0, 1.0));
    let change = |what, new| Command::ChangeLenslets { what, lenslets: vec![(index, new)] };
    let count = 1 + deed.index % 9;
    match deed.kind {
        0 => Command::AddLenslet(Lenslet::round(x, y, 0.8, 0.5)),
        1 => Command::DeleteLenslets(vec![index]),
        2 | 3 => change(LensletChange::Position, Lenslet { x, y, ..old }),
        4 => change(LensletChange::Width, Lenslet::round(old.x, old.y, 0.5 + 0.1 * x, old.weight)),
        5 => change(LensletChange::Weight, Lenslet { weight: y, ..old }),
        6 => Command::ReplaceEncoder {
            name: format!("{count} heuristic lenslets"),
            encoder: Encoder::Lenslets(heuristic_layout(count)),
        },
        7 => Command::SetObjects(ObjectSource::Beads { density: 0.001 * (1.0 + x.floor()) }),
        8 => Command::SetNoise(if deed.index.is_multiple_of(2) { Noise::Shot } else { Noise::Read { sigma: 1.0 + y } }),
        9 => Command::SetMeanPhotons(10.0 * y),
        _ => Command::SetSeed(deed.index as u64),
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 48,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(20_261_122),
        ..ProptestConfig::default()
    })]

    #[test]
    fn as_many_undos_bring_back_the_start_and_redos_the_end(deeds in deeds()) {
        let start = Design::default();
        let mut session = Session::new(start.clone(), None, || {}).unwrap();
        session.set_live(false);
        let mut was_down = false;
        for deed in &deeds {
            session.note_pointer(deed.down, deed.down && !was_down);
            was_down = deed.down;
            let command = command(deed, session.design());
            let before = session.design().clone();
            if session.apply(&command).is_err() {
                prop_assert_eq!(session.design(), &before, "a refused command changes nothing");
            }
        }
        let end = session.design().clone();
        let mut steps = 0;
        while session.undoes().is_some() {
            session.undo();
            steps += 1;
        }
        prop_assert_eq!(&**session.design(), &start);
        prop_assert!(!session.is_dirty() && steps <= deeds.len());
        for _ in 0..steps {
            prop_assert!(session.redoes().is_some());
            session.redo();
        }
        prop_assert_eq!(session.design(), &end);
        prop_assert!(session.redoes().is_none());
    }
}

#[test]
fn a_drag_of_the_density_is_one_step_and_so_is_every_choice_of_objects() {
    let mut session = Session::new(Design::default(), None, || {}).unwrap();
    session.set_live(false);
    let beads = |density| ObjectSource::Beads { density };
    let start = beads(0.02);
    assert_eq!(session.design().objects, start);
    session.note_pointer(true, true);
    for step in 1..=5 {
        session.apply(&Command::SetObjects(beads(0.02 + 0.001 * f64::from(step)))).unwrap();
    }
    session.note_pointer(false, false);
    let dragged = session.design().objects.clone();
    let chosen = [beads(0.03), beads(0.04), ObjectSource::BeadsMax { density: 0.04 }];
    for source in &chosen {
        // A tap that ends within a frame.
        session.note_pointer(false, true);
        session.apply(&Command::SetObjects(source.clone())).unwrap();
    }
    // By keys alone, sooner than two changes of one number would be two steps.
    session.apply(&Command::SetObjects(ObjectSource::Volume { planes: 5, density: 0.04 })).unwrap();
    for source in chosen.iter().rev().chain([&dragged, &start]) {
        session.undo();
        assert_eq!(session.design().objects, *source);
    }
    assert_eq!(session.undoes(), None);
}

#[test]
fn lenslets_that_are_added_in_quick_succession_are_steps_of_their_own() {
    let mut session = Session::new(Design::default(), None, || {}).unwrap();
    session.set_live(false);
    for _ in 0..2 {
        session.apply(&Command::AddLenslet(Lenslet::round(16.0, 16.0, 0.8, 0.5))).unwrap();
    }
    session.undo();
    assert_eq!(session.design().encoder.lenslets().unwrap().lenslets.len(), 10);
}

/// A session, and a message for each piece of its news.
fn heard() -> (Session, Receiver<()>) {
    let (wake, news) = channel();
    // The last news may come when nobody listens.
    let session = Session::new(Design::default(), None, move || wake.send(()).unwrap_or_default()).unwrap();
    session.set_live(false);
    (session, news)
}

/// Answers of the worker to all requests.
fn answers(session: &mut Session, news: &Receiver<()>) -> Vec<Result<Outcome, String>> {
    let mut answers = session.take_outcomes();
    while session.has_open_jobs() {
        news.recv_timeout(Duration::from_mins(1)).expect("an answer");
        answers.extend(session.take_outcomes());
    }
    answers
}

#[test]
fn a_save_that_ends_late_does_not_give_its_file_to_another_design() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("first.json");
    let (mut session, news) = heard();
    session.apply(&Command::SetSeed(7)).unwrap();
    session.save_to(file.clone());
    session.start_from(Design { seed: 8, ..Design::default() });
    assert!(matches!(answers(&mut session, &news)[..], [Ok(Outcome::Saved { .. })]));
    assert_eq!(Design::open(&file).unwrap().seed, 7);
    assert_eq!(session.path(), None, "the next save would overwrite the first design");
    session.apply(&Command::SetSeed(9)).unwrap();
    assert!(session.is_dirty());
}

#[test]
fn a_file_that_is_read_late_does_not_take_the_place_of_edits() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("other.json");
    Design { seed: 7, ..Design::default() }.save(&file).unwrap();
    let (mut session, news) = heard();
    session.open_file(file.clone());
    session.apply(&Command::SetSeed(9)).unwrap();
    let told = answers(&mut session, &news);
    assert!(matches!(&told[..], [Err(reason)] if reason.contains("changed meanwhile")), "{told:?}");
    assert_eq!((session.design().seed, session.path()), (9, None));
    session.open_file(file.clone());
    assert!(matches!(answers(&mut session, &news)[..], [Ok(Outcome::Opened { .. })]));
    assert_eq!((session.design().seed, session.path()), (7, Some(file.as_path())));
}

#[test]
fn what_is_read_late_is_not_used_for_another_design() {
    let folder = tempfile::tempdir().unwrap();
    let objects = folder.path().join("objects.npy");
    lenslet_studio::formats::write_array(&objects, ndarray::Array3::<f32>::ones((3, 96, 96)).view()).unwrap();
    let (mut session, news) = heard();
    session.open_objects(ObjectSource::Stack(objects.clone()));
    let psf = folder.path().join("psf.npy");
    lenslet_studio::formats::write_array(&psf, ndarray::Array2::<f32>::ones((64, 64)).view()).unwrap();
    session.import_psf(psf, Some(32));
    session.start_from(Design { seed: 8, ..Design::default() });
    let told = answers(&mut session, &news);
    assert_eq!(told.len(), 2);
    assert!(told.iter().all(|told| told.as_ref().is_err_and(|reason| reason.contains("opened meanwhile"))), "{told:?}");
    assert_eq!(**session.design(), Design { seed: 8, ..Design::default() });
    assert!(!session.is_dirty());
    session.open_objects(ObjectSource::Stack(objects.clone()));
    assert!(matches!(answers(&mut session, &news)[..], [Ok(Outcome::ObjectsOpened { .. })]));
    assert_eq!(session.design().objects, ObjectSource::Stack(objects));
}
