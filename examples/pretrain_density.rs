//! Pretrains the causal density model on beads, drawn images and many masks.
//!
//! `cargo run --release --example pretrain_density OUT MINUTES [SEED] [START]`; with START, the fit resumes from that file.

mod training_data;

use lenslet_studio::information::{PretrainProgress, PretrainStep, PretrainedWeights};
use training_data::{Arguments, WeightsFile, training_scene};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let Arguments { out, budget, seed, start, .. } = Arguments::from_env()?;
    let mut weights = match &start {
        Some(bytes) => PretrainedWeights::from_bytes(bytes)?,
        None => PretrainedWeights::new(seed),
    };
    let mut file = WeightsFile::new(&out);
    let on_step = &mut |step: &PretrainStep<'_>| {
        let PretrainProgress { steps, scenes, bits, .. } = step.progress;
        file.update(&format!("{steps} steps, {scenes} scenes, {bits:.4} bits per pixel"), &|| step.weights().to_bytes())
    };
    let fitted = weights.fit(&|number| training_scene(seed, number), budget, seed, on_step);
    file.finish(fitted, weights.to_bytes())
}
