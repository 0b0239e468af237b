//! Valid convolution of 10,000 objects (96x96, 32x32 PSF) against `scipy.signal.fftconvolve` called image by image,
//! both in one run. Needs `python3` with scipy for the comparison; without it only our own time is printed.

use std::process::Command;
use std::time::Instant;

use lenslet_studio::optics::{heuristic_layout, render_psf};
use lenslet_studio::sensor::Convolution;
use ndarray::Array4;

const OBJECTS: usize = 10_000;
const BATCH: usize = 500;
const ROUNDS: usize = 5;

/// Images per second over all objects, the median of a few rounds.
fn ours(threads: usize) -> f64 {
    let psf = render_psf(&heuristic_layout(9), 1).expect("renders");
    let convolver = Convolution::new((96, 96), (32, 32)).and_then(|plan| plan.with_psf(psf.view())).expect("fits");
    let objects = Array4::from_shape_fn((BATCH, 1, 96, 96), |(n, _, row, col)| ((n + row * 7 + col * 3) % 256) as f32);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let mut rates: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            for _ in 0..OBJECTS / BATCH {
                let images = pool.install(|| convolver.measure(objects.view(), 10.0)).expect("fits");
                assert_eq!(images.dim(), (BATCH, 65, 65));
            }
            OBJECTS as f64 / start.elapsed().as_secs_f64()
        })
        .collect();
    rates.sort_by(f64::total_cmp);
    rates[ROUNDS / 2]
}

/// Images per second of scipy, the median of a few rounds.
fn scipy() -> Option<f64> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/fftconvolve.py");
    let output = Command::new("python3").arg(script).output().ok()?;
    String::from_utf8(output.stdout).ok()?.trim().parse().ok()
}

fn main() {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let reference = scipy();
    for threads in if cores > 1 { vec![1, cores] } else { vec![1] } {
        let rate = ours(threads);
        print!("{threads} thread(s): {rate:.0} images/s");
        match reference {
            Some(reference) => println!("; scipy {reference:.0} images/s; ratio {:.1}", rate / reference),
            None => println!("; scipy was not found"),
        }
    }
}
