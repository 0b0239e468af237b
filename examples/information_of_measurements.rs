//! Information of images of a camera, from a file: here simulated ones in place of a camera's.
//!
//! `cargo run --example information_of_measurements`

use lenslet_studio::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // A camera with a system gain of 2 DN per photon and an offset of 64 DN.
    let calibration = Calibration { gain: 2.0, offset: 64.0, bin: 1 };
    let design = Design::default();
    let model = ForwardModel::open(&design)?;
    let photons = model.simulate(model.psf(&design)?.view(), 0..60, design.seed)?.noisy;
    let grey = photons.mapv(|photons| 2.0 * photons + 64.0);

    let file = std::env::temp_dir().join(format!("measurements-{}.npy", std::process::id()));
    write_array(&file, grey.view().into_dyn())?;

    // The noise is that of the photons.
    let progress = &mut CancelToken::new();
    let images = MeasuredImages::open(&MeasuredSource::from(file.clone()), &calibration, progress)?;
    let request = EstimateRequest::new(Estimator::GaussianStationary).with_patch(16, 16).with_patches(1_000, 300);
    let result = images.estimate(&request, Noise::Shot, 1, progress)?;
    println!("{}: {:.3} bits per pixel", result.objects, result.bits_per_pixel);
    for note in &result.notes {
        println!("note: {note}");
    }

    std::fs::remove_file(file)?;
    Ok(())
}
