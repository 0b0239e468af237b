//! Gaussian information estimates of three masks, in bits per pixel.
//!
//! `cargo run --example information_of_a_mask`

use lenslet_studio::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // A stationary Gaussian is fitted to 1,000 patches and scored on 300 held-out ones.
    let request = EstimateRequest::new(Estimator::GaussianStationary).with_patch(16, 16).with_patches(1_000, 300);

    for lenslets in [1, 4, 9] {
        let design = Design { encoder: Encoder::Lenslets(heuristic_layout(lenslets)), ..Design::default() };
        let result = estimate(&design, &request, &mut CancelToken::new())?;
        let [low, high] = result.interval_95;
        println!("{}: at most {:.3} [{low:.3}, {high:.3}] bits per pixel", result.encoder, result.bits_per_pixel);
    }
    Ok(())
}
