//! Flags that say which design a command is about.

use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;

use super::choices::EncoderChoice;
use crate::objects::ObjectSource;
use crate::sensor::Noise;
use crate::workbench::{DESIGN_FILE, Design};

/// Most bytes that are read from standard input.
const LARGEST_DESIGN: u64 = 256 << 20;
const STANDARD_INPUT: &str = "standard input";

/// A design: a file, flags, or a file with some entries replaced by flags.
#[derive(Args, Debug)]
pub struct DesignArgs {
    /// Design file, or - for standard input; flags replace its entries. Without one, flags replace entries of the default design.
    design: Option<PathBuf>,

    /// The mask: heuristic:1 to 9, random:COUNT, depth:1 to 5, diffuser:APERTURE, psf:FILE (psf:FILE@32 resamples),
    /// fit:FILE for lenslets that are fitted to a PSF picture, or design:FILE.
    #[arg(long, value_name = "MASK")]
    lenslets: Option<EncoderChoice>,

    /// Seed of random masks, objects, noise and patches.
    #[arg(long)]
    seed: Option<u64>,
}

/// What the mask looks at, and the sensor behind it.
#[derive(Args, Debug)]
pub struct SceneArgs {
    /// The objects: beads:DENSITY, beads-max:DENSITY, volume:PLANES:DENSITY, idx:FILE, cifar:FILE, images:FOLDER, or
    /// stack:FILE.
    #[arg(long, value_name = "OBJECTS")]
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
    /// Refuses to put `design` in place of the file that was given, where that holds another.
    pub fn check_file_stays(&self, out: &Path, design: &Design) -> anyhow::Result<()> {
        let mask = self.lenslets.as_ref().and_then(EncoderChoice::design_file);
        [self.design.as_deref(), mask].into_iter().try_for_each(|file| check_input_stays(file, out, Some(design)))
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

/// Refuses to put another design in place of the file that one was read from: `DESIGN_FILE` in `out` will hold `design`, or one
/// that is not known yet.
pub fn check_input_stays(input: Option<&Path>, out: &Path, design: Option<&Design>) -> anyhow::Result<()> {
    let output = out.join(DESIGN_FILE);
    let Some(input) = input.filter(|input| *input != Path::new("-")) else { return Ok(()) };
    let (Ok(read), Ok(written)) = (input.canonicalize(), output.canonicalize()) else { return Ok(()) };
    if read == written && (design.is_none() || Design::open(input).ok().as_ref() != design) {
        bail!("{}: another design would take the place of this one; choose another --out", input.display());
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
