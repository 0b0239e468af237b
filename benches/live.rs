//! How the live estimate follows edits: time from an edit to its first number, what it says after 5 s, and where it settles.
//!
//! `cargo bench --bench live -- OBJECTS=LENSLETS ...` takes other scenes and heuristic layouts than nine lenslets before beads of
//! density 0.02, such as `beads:0.11=4` or `idx:FILE=1`.

use std::time::{Duration, Instant};

use lenslet_studio::optics::{Encoder, heuristic_layout};
use lenslet_studio::workbench::{Command, Design, LiveEstimate, Workbench};

/// Seconds after an edit at which the estimate is read a second time.
const SOON: f64 = 5.0;
/// Edits after the first estimate, from cold.
const EDITS: usize = 2;

/// Waits for the live estimate of the open design to be as wanted; returns it and the seconds since `edited`.
fn wait(bench: &Workbench, edited: Instant, wanted: impl Fn(&LiveEstimate) -> bool) -> (LiveEstimate, f64) {
    loop {
        let live = bench.estimates().live;
        if let Some(live) = live.filter(|live| live.revision == bench.revision() && wanted(&live.value)) {
            return (LiveEstimate::clone(&live.value), edited.elapsed().as_secs_f64());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Follows the edits of one scene; returns the longest time to a first number and the largest distance from the settled one, 5 s
/// after an edit.
fn follow(scene: &str) -> Result<(f64, f64), Box<dyn std::error::Error>> {
    let (objects, lenslets) = scene.rsplit_once('=').ok_or("a scene is OBJECTS=LENSLETS")?;
    let start = heuristic_layout(lenslets.parse()?);
    let design = Design { objects: objects.parse()?, encoder: Encoder::Lenslets(start.clone()), ..Design::default() };
    let mut edited = Instant::now();
    let mut bench = Workbench::new(design, None, || ())?;
    let mut worst = (0.0_f64, 0.0_f64);
    for edit in 0..=EDITS {
        if edit > 0 {
            let mut array = start.clone();
            // One lenslet goes its way, a pixel or two at a time.
            let moved = array.lenslets.last_mut().ok_or("no lenslet")?;
            moved.x += edit as f64 * 1.5;
            moved.y += edit as f64;
            edited = Instant::now();
            bench.apply(&Command::ReplaceEncoder { name: "move".into(), encoder: Encoder::Lenslets(array) })?;
        }
        let (first, first_seconds) = wait(&bench, edited, |_| true);
        let is_later = |live: &LiveEstimate| live.remaining.is_none() || edited.elapsed().as_secs_f64() > SOON;
        let (soon, _) = wait(&bench, edited, is_later);
        let (settled, seconds) = wait(&bench, edited, |live| live.remaining.is_none());
        let off = (soon.bits_per_pixel - settled.bits_per_pixel).abs();
        if edit > 0 {
            worst = (worst.0.max(first_seconds), worst.1.max(off));
        }
        let name = if edit == 0 { "from cold".to_owned() } else { format!("edit {edit}") };
        let scene: String = scene.chars().rev().take(26).collect::<Vec<_>>().into_iter().rev().collect();
        println!(
            "{scene:>26} {name:9} {first_seconds:7.2}  {:7.4} {:6.4}   {:6.4} ({seconds:.0})   {off:.4}",
            first.bits_per_pixel, soon.bits_per_pixel, settled.bits_per_pixel
        );
    }
    Ok(worst)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Cargo adds a flag of its own.
    let given: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let scenes = if given.is_empty() { vec!["beads:0.02=9".to_owned()] } else { given };
    println!("                     scene           first s    first    5 s  settled (s)   off after 5 s");
    let mut worst = (0.0_f64, 0.0_f64);
    for scene in &scenes {
        let (seconds, off) = follow(scene)?;
        worst = (worst.0.max(seconds), worst.1.max(off));
    }
    println!(
        "after edits at most {:.2} s to the first number, {:.4} bits per pixel off after {SOON} s",
        worst.0, worst.1
    );
    Ok(())
}
