//! What the program does where it cannot open a window: the same design, computed and exported.

use std::ops::ControlFlow;
use std::path::Path;

use super::choices::about_objects;
use super::{Failure, output};
use crate::information::{NoiseEntropy, Protocol};
use crate::workbench::{Design, EvaluationError, Optics, Scene, SceneOptics, export_design};

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
    let mut lines = vec![
        format!("{} before {}, {} noise", design.encoder.describe(), design.objects, design.noise),
        format!("  {}", scene.set.describe()),
    ];
    lines.extend(scene.set.notices().iter().map(|notice| format!("  {notice}")));
    lines.extend(numbers(design, &scene).map_err(|error| about_objects(design, error))?);
    let exported = export_design(design, Path::new(FOLDER));
    if let Ok(files) = &exported {
        lines.push(format!("Exported to {FOLDER}:"));
        let names = files.iter().filter_map(|file| file.file_name());
        lines.extend(names.map(|name| format!("  {}", name.to_string_lossy())));
    }
    // Whatever becomes of the files, the numbers are told.
    let printed = output::print(&lines.join("\n"));
    exported?;
    printed
}

/// Information and Tamura coefficients, line by line.
fn numbers(design: &Design, scene: &Scene) -> Result<Vec<String>, EvaluationError> {
    let optics = Optics::of(design, scene.set.planes())?;
    let prepared = SceneOptics::new(scene, design.encoder.grid())?;
    let measurements = prepared.measure(design, &optics, scene)?;
    let information = NoiseEntropy::new(design.noise, Protocol::Default)
        .map_err(EvaluationError::from)
        .and_then(|entropy| prepared.information(design, &optics, scene, &measurements, &entropy));
    let mut lines = Vec::new();
    match information {
        Ok(information) => {
            let (rows, cols) = information.patch;
            let [low, high] = information.interval_95;
            let bound = information.gaussian.bits_per_pixel;
            lines.push(format!("Information of a {rows} x {cols} px patch, bits per pixel:"));
            lines.push(format!("  at most {bound:.3} [{low:.3}, {high:.3}]  Gaussian bound"));
            lines.push(match information.ceiling_bits() {
                Some(ceiling) => format!("  at most {ceiling:.3}                 object-entropy ceiling"),
                None => "  ceiling unknown: the entropy of these objects is not known".into(),
            });
        }
        // Without noise, say: the mask can be exported all the same.
        Err(EvaluationError::Information(error)) => lines.push(format!("No information: {error}")),
        Err(error) => return Err(error),
    }
    let (sensor, objects) = (measurements.tamura.mean, scene.tamura.mean);
    lines.push(format!("Tamura coefficient: sensor {sensor:.3}, objects {objects:.3}"));
    Ok(lines)
}
