//! How the live estimate follows edits: time from an edit to its first number, what it says after 5 s, and where it settles.

use std::time::{Duration, Instant};

use lenslet_studio::optics::{Encoder, heuristic_layout};
use lenslet_studio::workbench::{Command, Design, LiveEstimate, Workbench};

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

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut bench = Workbench::new(Design::default(), None, || ())?;
    println!("edit                        first s    first    5 s  settled (s)   bits per pixel");
    let mut edited = Instant::now();
    let mut name = "start, 9 lenslets".to_owned();
    for edit in 0..5 {
        if edit > 0 {
            let mut array = heuristic_layout(9);
            // One lenslet goes its way, a pixel or two at a time.
            array.lenslets[1].x += f64::from(edit) * 1.5;
            array.lenslets[1].y += f64::from(edit);
            edited = Instant::now();
            name = format!("one lenslet moved, edit {edit}");
            bench.apply(&Command::ReplaceEncoder { name: name.clone(), encoder: Encoder::Lenslets(array) })?;
        }
        let (first, first_seconds) = wait(&bench, edited, |_| true);
        let (after, _) = wait(&bench, edited, |live| live.remaining.is_none() || edited.elapsed().as_secs_f64() > 5.0);
        let (settled, seconds) = wait(&bench, edited, |live| live.remaining.is_none());
        println!(
            "{name:27} {first_seconds:7.2}  {:7.4} {:6.4}   {:6.4} ({seconds:.0})",
            first.bits_per_pixel, after.bits_per_pixel, settled.bits_per_pixel
        );
    }
    Ok(())
}
