//! What the program does where it cannot open a window: the same design, computed and exported.

use std::ops::ControlFlow;
use std::path::Path;

use super::Failure;
use crate::workbench::{Design, Optics, Scene, SceneOptics, export_design};

/// Folder that a run without a window exports to.
const FOLDER: &str = "lenslet-studio-export";

/// The design of a file, or the default one.
pub fn design(path: Option<&Path>) -> anyhow::Result<Design> {
    Ok(match path {
        Some(path) => Design::open(path)?,
        None => Design::default(),
    })
}

/// Whether there is something to open a window on.
#[cfg(feature = "studio")]
pub fn has_display() -> bool {
    let named = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    // Elsewhere the system always has one, or says so when the window is opened.
    !cfg!(target_os = "linux") || named("DISPLAY") || named("WAYLAND_DISPLAY")
}

/// Computes a design as the window would, prints its numbers, and exports it.
pub fn run(design: &Design) -> Result<(), Failure> {
    let scene = Scene::open(design, &|_| ControlFlow::Continue(()))?;
    let optics = Optics::of(design, scene.set.planes())?;
    let prepared = SceneOptics::new(&scene, design.encoder.grid())?;
    let measurements = prepared.measure(design, &optics, &scene)?;
    println!("{} before {}, {} noise", design.encoder.describe(), design.objects, design.noise);
    println!("  {}", scene.set.describe());
    let noise_entropy = crate::information::NoiseEntropy::new(design.noise, crate::information::Protocol::Default)?;
    let information = prepared.information(design, &optics, &scene, &measurements, &noise_entropy)?;
    let (rows, cols) = information.patch;
    let [low, high] = information.interval_95;
    let bound = information.gaussian.bits_per_pixel;
    println!("Information of a {rows} x {cols} px patch, bits per pixel:");
    println!("  at most {bound:.3} [{low:.3}, {high:.3}]  Gaussian bound");
    match information.ceiling_bits() {
        Some(ceiling) => println!("  at most {ceiling:.3}                 object-entropy ceiling"),
        None => println!("  ceiling unknown: the entropy of these objects is not known"),
    }
    println!("Tamura coefficient: sensor {:.3}, objects {:.3}", measurements.tamura.mean, scene.tamura.mean);
    let folder = Path::new(FOLDER);
    let files = export_design(design, folder)?;
    println!("Exported to {FOLDER}:");
    for file in files.iter().filter_map(|file| file.file_name()) {
        println!("  {}", file.to_string_lossy());
    }
    Ok(())
}
