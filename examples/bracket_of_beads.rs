//! Lower and upper bounds on the information about beads, whose prior is known.
//!
//! `cargo run --example bracket_of_beads`

use lenslet_studio::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let design = Design {
        encoder: Encoder::Lenslets(heuristic_layout(4)),
        objects: ObjectSource::Beads { density: 0.02 },
        ..Design::default()
    };

    // A number of steps in place of a time: the same seed gives the same numbers.
    let request = EstimateRequest::new(Estimator::Bracket).with_patch(8, 8).with_patches(500, 40).with_steps(5);
    let result = estimate(&design, &request, &mut CancelToken::new())?;

    let bracket = result.bracket.as_ref().ok_or("expected bounds, found one estimate")?;
    for bound in &bracket.lower_bounds {
        println!("at least {:.4} bits per pixel: {}", bound.bits_per_pixel, bound.from);
    }
    for bound in &bracket.upper_bounds {
        println!("at most  {:.4} bits per pixel: {}", bound.bits_per_pixel, bound.from);
    }
    Ok(())
}
