//! A short optimization of two lenslets (IDEAL): their positions after gradient ascent on the information.
//!
//! `cargo run --example short_optimization`

use lenslet_studio::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Small objects and a small mask, so that the run takes seconds.
    let options = ObjectOptions { field: (27, 27), ..ObjectOptions::default() };
    let set = ObjectSet::open(&ObjectSource::Beads { density: 0.05 }, &options)?;
    let background = 10.0;
    let model = ForwardModel::new(set, (12, 12), background, Noise::Shot)?;
    // Centre (x, y) and width in px, and weight.
    let start = LensletArray::new(12, 12, vec![Lenslet::round(3.0, 4.0, 1.6, 0.7), Lenslet::round(8.0, 7.5, 1.2, 0.3)]);

    let settings = IdealSettings {
        steps: 12,
        objects: 6,
        patches: 8,
        patch: Some((8, 8)),
        refit_every: 4,
        first_fit: 60,
        refit: 20,
        last_fit: 60,
        ..IdealSettings::new(Preset::Default, Objective::Density, 3)
    };
    let mut optimizer = IdealOptimizer::new(&model, &start, Limits::default(), settings)?;
    while !optimizer.is_finished() {
        optimizer.advance(&mut CancelToken::new())?;
    }

    for checkpoint in &optimizer.state().checkpoints {
        println!("step {}: {:.3} bits per pixel", checkpoint.step, checkpoint.bits_per_pixel);
    }
    if let Some(last) = optimizer.state().checkpoints.last() {
        for lenslet in &last.array.lenslets {
            println!("lenslet at ({:.2}, {:.2}) px, weight {:.2}", lenslet.x, lenslet.y, lenslet.weight);
        }
    }
    Ok(())
}
