//! The PSF of a mask and one simulated measurement: shapes, light and noise.
//!
//! `cargo run --example psf_and_measurement`

use lenslet_studio::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Nine lenslets on a grid of 32 x 32 px image beads; the sensor has shot noise.
    let design = Design {
        encoder: Encoder::Lenslets(heuristic_layout(9)),
        objects: "beads:0.02".parse()?,
        noise: Noise::Shot,
        seed: 1,
        ..Design::default()
    };

    let psf = design.psf(1)?;
    println!("PSF: shape {:?} (planes, rows, cols), sum {:.3}", psf.dim(), psf.sum());

    // Object and noise of a measurement depend on its number and the seed only.
    let model = ForwardModel::open(&design)?;
    let Simulated { objects, noiseless, noisy } = model.simulate(psf.view(), 0..4, design.seed)?;
    println!("Objects: shape {:?}, mean {:.1} photons per pixel", objects.dim(), objects.mean().unwrap_or(0.0));
    println!("Measurements: shape {:?}, mean {:.1} photons per pixel", noisy.dim(), noisy.mean().unwrap_or(0.0));

    let noise = &noisy - &noiseless;
    println!("Noise: standard deviation {:.2} photons", noise.std(0.0));
    Ok(())
}
