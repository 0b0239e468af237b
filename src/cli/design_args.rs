//! Flags that say which design a command is about.

use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;

use super::choices::{EncoderChoice, encoder_argument, objects_argument};
use crate::forward::Design;
use crate::objects::ObjectSource;
use crate::sensor::Noise;
use crate::workbench::DESIGN_FILE;

/// Most bytes that are read from standard input.
const LARGEST_DESIGN: u64 = 256 << 20;
const STANDARD_INPUT: &str = "standard input";

/// A design: a file, flags, or a file with some entries replaced by flags.
#[derive(Args, Debug)]
pub struct DesignArgs {
    /// Design file, or - for standard input; flags replace its entries. Without one, flags replace entries of the default design.
    design: Option<PathBuf>,

    /// The mask: heuristic:1 to 9, random:COUNT, depth:1 to 5, diffuser:APERTURE, psf:FILE (psf:FILE@32 resamples),
    /// fit:FILE for lenslets that are fitted to a PSF image, or design:FILE. FILE?key=psf&channel=green tells what a file
    /// means.
    #[arg(long, value_name = "MASK", value_parser = encoder_argument())]
    lenslets: Option<EncoderChoice>,

    /// Seed of random masks, objects, noise and patches.
    #[arg(long)]
    seed: Option<u64>,
}

/// What the mask looks at, and the sensor behind it.
#[derive(Args, Debug)]
pub struct SceneArgs {
    /// The objects: beads:DENSITY, beads-max:DENSITY, volume:PLANES:DENSITY, idx:FILE, cifar:FILE, images:FOLDER, or
    /// stack:FILE. Where a file does not say what it means, its path does: FILE?axis=last&key=NAME&channel=green&frame=3.
    #[arg(long, value_name = "OBJECTS", value_parser = objects_argument())]
    objects: Option<ObjectSource>,

    /// Mean of the objects, photons per pixel.
    #[arg(long, value_name = "PHOTONS")]
    mean_photons: Option<f64>,

    /// Background, photons per pixel.
    #[arg(long, value_name = "PHOTONS")]
    bias: Option<f64>,

    /// Noise of the sensor: shot, read:SIGMA, shot+read:SIGMA or none.
    #[arg(long)]
    noise: Option<Noise>,
}

impl DesignArgs {
    /// Refuses to put any of `outputs` in place of a file that `design` is made from, but for one that holds this very design.
    pub fn check_inputs_stay(&self, outputs: &[PathBuf], design: &Design) -> anyhow::Result<()> {
        check_inputs_stay(&self.files(design), outputs, ("--out", Some(design)))
    }

    /// The files that `design` is made from.
    pub fn files(&self, design: &Design) -> Vec<PathBuf> {
        files_of([self.design.clone(), self.lenslets.as_ref().and_then(EncoderChoice::file)], &design.objects)
    }

    /// The design, with the scene replaced by what `scene` gives.
    pub fn design(&self, scene: &SceneArgs) -> anyhow::Result<Design> {
        let mut design = match &self.design {
            Some(path) => open_design(path)?,
            None => Design::default(),
        };
        if let Some(seed) = self.seed {
            design.seed = seed;
        }
        if let Some(choice) = &self.lenslets {
            design.encoder = choice.encoder(design.seed)?;
        }
        scene.replace_in(&mut design);
        design.check()?;
        Ok(design)
    }
}

/// The files that are read: those that are `named`, but for standard input, and those of the objects.
pub fn files_of(named: [Option<PathBuf>; 2], objects: &ObjectSource) -> Vec<PathBuf> {
    let named = named.into_iter().flatten().filter(|input| input != Path::new("-"));
    named.chain(objects.files()).collect()
}

/// Refuses a folder in which one of these files lies beside the design of another mask, as whose it would pass from then on.
pub(super) fn check_no_other(folder: &Path, design: &Design, files: &[&str]) -> anyhow::Result<()> {
    let is_other = Design::open(&folder.join(DESIGN_FILE)).is_ok_and(|there| there.encoder != design.encoder);
    match files.iter().find(|name| is_other && folder.join(name).exists()) {
        Some(name) => bail!(
            "{}: expected a folder for this mask, found {name} of another; choose another --out",
            folder.display()
        ),
        None => Ok(()),
    }
}

/// Refuses to put one of the files `outputs`, which `flag` names, in place of one of the `inputs`. A design file may be written
/// again as it is: where it will hold `design`.
pub fn check_inputs_stay(
    inputs: &[PathBuf],
    outputs: &[PathBuf],
    (flag, design): (&str, Option<&Design>),
) -> anyhow::Result<()> {
    // What is not there yet takes no place.
    let outputs: Vec<_> = outputs.iter().filter_map(|output| Some((output.canonicalize().ok()?, output))).collect();
    if outputs.is_empty() {
        return Ok(());
    }
    for input in inputs {
        let Ok(read) = input.canonicalize() else { continue };
        let Some((_, output)) = outputs.iter().find(|(place, _)| *place == read) else { continue };
        let stays = output.ends_with(DESIGN_FILE) && design.is_some() && Design::open(input).ok().as_ref() == design;
        if !stays {
            bail!("{}: a file of the result would take the place of this one; choose another {flag}", input.display());
        }
    }
    Ok(())
}

/// Reads a design from a file, or from standard input where it is called `-`.
pub fn open_design(path: &Path) -> anyhow::Result<Design> {
    if path != Path::new("-") {
        return Ok(Design::open(path)?);
    }
    let value = serde_json::from_reader(std::io::stdin().lock().take(LARGEST_DESIGN))
        .with_context(|| format!("{STANDARD_INPUT}: expected the JSON of a design"))?;
    Ok(Design::from_value(value, STANDARD_INPUT)?)
}

impl SceneArgs {
    /// Puts what was given in place of what a design says.
    pub fn replace_in(&self, design: &mut Design) {
        if let Some(objects) = &self.objects {
            design.objects = objects.clone();
        }
        design.mean_photons = self.mean_photons.unwrap_or(design.mean_photons);
        design.bias_photons = self.bias.unwrap_or(design.bias_photons);
        design.noise = self.noise.unwrap_or(design.noise);
    }
}
