//! How the live estimate follows edits: time from an edit to its first number, what it says after 5 s, and where it settles.
//!
//! `cargo bench --bench live -- OBJECTS=LENSLETS ...` takes other scenes and heuristic layouts than nine lenslets before beads of
//! density 0.02, such as `beads:0.11=4` or `idx:FILE=1`. `beads:0.02=9@64/192` has a PSF grid of 64 px and a field of 192 px.
//! With the word `first` it does not wait for settled estimates.

use std::time::{Duration, Instant};

use lenslet_studio::forward::Design;
use lenslet_studio::optics::{Encoder, LensletArray, heuristic_layout};
use lenslet_studio::workbench::{Command, LiveEstimate, Session};

/// Seconds after an edit at which the estimate is read a second time.
const SOON: f64 = 5.0;
/// Seconds between two edits of which the second comes while the first one is scored.
const HASTY: f64 = 4.65;
/// Edits after the first estimate, from cold.
const EDITS: usize = 2;

/// Waits for the live estimate of the open design to be as wanted; returns it and the seconds since `edited`.
fn wait(bench: &Session, edited: Instant, wanted: impl Fn(&LiveEstimate) -> bool) -> (LiveEstimate, f64) {
    loop {
        let live = bench.estimates().live;
        if let Some(live) = live.filter(|live| live.revision == bench.revision() && wanted(&live.value)) {
            return (LiveEstimate::clone(&live.value), edited.elapsed().as_secs_f64());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The smallest bound from above: of an estimate, and the ceiling where there is one, which comes with every edit.
fn upper(live: &LiveEstimate, ceiling: Option<f64>) -> f64 {
    let sampled = live.upper.as_ref().map(|upper| upper.bits_per_pixel);
    sampled.into_iter().chain(ceiling).fold(live.bits_per_pixel, f64::min)
}

/// What a scene's edits have come to at the worst.
#[derive(Clone, Copy, Default)]
struct Worst {
    /// Seconds to a first number.
    first_seconds: f64,
    /// Distances of density model and smallest bound from what they settle at, 5 s after an edit.
    off: f64,
    upper_off: f64,
}

impl Worst {
    fn and(self, other: Self) -> Self {
        Self {
            first_seconds: self.first_seconds.max(other.first_seconds),
            off: self.off.max(other.off),
            upper_off: self.upper_off.max(other.upper_off),
        }
    }
}

/// The lenslets and the design of a scene.
fn opened(scene: &str) -> Result<(LensletArray, Design), Box<dyn std::error::Error>> {
    let (objects, lenslets) =
        scene.rsplit_once('=').ok_or("a scene is OBJECTS=LENSLETS or OBJECTS=LENSLETS@GRID/FIELD")?;
    let (lenslets, sizes) = lenslets.split_once('@').unwrap_or((lenslets, "32/96"));
    let (grid, field) = sizes.split_once('/').ok_or("sizes are GRID/FIELD")?;
    let (grid, field): (usize, usize) = (grid.parse()?, field.parse()?);
    let start = heuristic_layout(lenslets.parse()?).on_grid(grid, grid);
    let encoder = Encoder::Lenslets(start.clone());
    let design = Design { objects: objects.parse()?, encoder, field: (field, field), ..Design::default() };
    Ok((start, design))
}

/// Moves one lenslet a pixel or two from its start, further at each edit.
fn apply(bench: &mut Session, start: &LensletArray, edit: usize) -> Result<Instant, Box<dyn std::error::Error>> {
    let mut array = start.clone();
    let moved = array.lenslets.last_mut().ok_or("no lenslet")?;
    moved.x += edit as f64 * 1.5;
    moved.y += edit as f64;
    let edited = Instant::now();
    bench.apply(&Command::ReplaceEncoder { name: "move".into(), encoder: Encoder::Lenslets(array) })?;
    Ok(edited)
}

/// Follows the edits of one scene, or waits for their first numbers alone.
fn follow(scene: &str, first_alone: bool) -> Result<Worst, Box<dyn std::error::Error>> {
    let (start, design) = opened(scene)?;
    let mut edited = Instant::now();
    let mut bench = Session::new(design, None, || ())?;
    let mut worst = Worst::default();
    for edit in 0..=EDITS {
        if edit > 0 {
            edited = apply(&mut bench, &start, edit)?;
        }
        let (first, first_seconds) = wait(&bench, edited, |_| true);
        if first_alone {
            println!("{scene:>26} edit {edit} {first_seconds:7.2} s  {:7.4} bits per pixel", first.bits_per_pixel);
            worst = worst.and(Worst { first_seconds, ..Worst::default() });
            continue;
        }
        let is_later = |live: &LiveEstimate| live.remaining.is_none() || edited.elapsed().as_secs_f64() > SOON;
        let (soon, _) = wait(&bench, edited, is_later);
        let (_, seconds) = wait(&bench, edited, |live| live.remaining.is_none());
        let (settled, _) = wait(&bench, edited, |live| live.remaining.is_none() && !live.bounding);
        let off = (soon.bits_per_pixel - settled.bits_per_pixel).abs();
        let information = bench.live().information;
        let ceiling = information.filter(|found| found.revision == bench.revision());
        let ceiling = ceiling.and_then(|found| found.value.ceiling_bits());
        let upper = |live: &LiveEstimate| upper(live, ceiling);
        let upper_off = (upper(&soon) - upper(&settled)).abs();
        if edit > 0 {
            worst = worst.and(Worst { first_seconds, off, upper_off });
        }
        let name = if edit == 0 { "from cold".to_owned() } else { format!("edit {edit}") };
        let scene: String = scene.chars().rev().take(26).collect::<Vec<_>>().into_iter().rev().collect();
        println!(
            "{scene:>26} {name:9} {first_seconds:7.2}  {:7.4} {:6.4}   {:6.4} ({seconds:.0})   {off:.4}          {:7.4} {:6.4}   {:6.4}   {upper_off:.4}",
            first.bits_per_pixel,
            soon.bits_per_pixel,
            settled.bits_per_pixel,
            upper(&first),
            upper(&soon),
            upper(&settled)
        );
    }
    if first_alone {
        return Ok(worst);
    }
    for (edit, after) in [(EDITS + 1, 0.0), (EDITS + 2, HASTY)] {
        std::thread::sleep(Duration::from_secs_f64(after));
        edited = apply(&mut bench, &start, edit)?;
    }
    let (_, seconds) = wait(&bench, edited, |_| true);
    println!("{:>36} {seconds:7.2}", format!("{HASTY} s after another"));
    Ok(worst.and(Worst { first_seconds: seconds, ..Worst::default() }))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Cargo adds a flag of its own.
    let mut given: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let first_alone = given.first().is_some_and(|word| word == "first");
    given.drain(..usize::from(first_alone));
    let scenes = if given.is_empty() { vec!["beads:0.02=9".to_owned()] } else { given };
    println!(
        "                     scene           first s    first    5 s  settled (s)   off after 5 s   smallest bound: the same"
    );
    let mut worst = Worst::default();
    for scene in &scenes {
        worst = worst.and(follow(scene, first_alone)?);
    }
    println!(
        "after edits at most {:.2} s to the first number; after {SOON} s {:.4} bits per pixel off, the smallest bound {:.4}",
        worst.first_seconds, worst.off, worst.upper_off
    );
    Ok(())
}
