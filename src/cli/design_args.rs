//! Flags that select the design of a command.

use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;

use super::choices::{check_count, field_argument, mask_argument, objects_argument, open_mask};
use super::output::report;
use crate::forward::{Design, MaskSource, on_grid};
use crate::objects::{ObjectSource, Placement};
use crate::optics::LensletArray;
use crate::sensor::Noise;
use crate::workbench::DESIGN_FILE;

/// Largest design read from standard input, bytes.
const LARGEST_DESIGN: u64 = 256 << 20;
const STANDARD_INPUT: &str = "standard input";

/// A design: a file, flags, or a file with entries replaced by flags.
#[derive(Args, Debug)]
pub struct DesignArgs {
    /// Design file, or - for standard input [default: the default design]. Flags replace its entries.
    design: Option<PathBuf>,

    /// Mask: heuristic:1 to 9, random:COUNT, depth:1 to 5, diffuser:APERTURE, psf:FILE, fit:FILE (lenslets fitted to a PSF
    /// image), or design:FILE. FILE?key=psf&channel=green selects an array and a channel of a file;
    /// FILE?dark=corners&window=auto&bin=25 makes a PSF of a photograph, as do the settings of a TOML file.
    #[arg(long, alias = "lenslets", value_name = "MASK", value_parser = mask_argument())]
    mask: Option<MaskSource>,

    #[command(flatten)]
    grid: GridArg,

    #[command(flatten)]
    throughput: ThroughputArg,

    /// Seed of random masks, objects, noise and patches.
    #[arg(long)]
    seed: Option<u64>,
}

/// The flag `--grid`, and its former spelling.
#[derive(Args, Debug)]
pub struct GridArg {
    /// Side of the PSF grid, pixels. Positions of lenslets and apertures scale with it, widths of spots do not. A PSF image of psf:FILE or
    /// fit:FILE is resampled [default: the grid of the design, or that of the file of the mask].
    #[arg(long, alias = "resample", value_name = "PIXELS")]
    grid: Option<usize>,
}

impl GridArg {
    /// The design with this mask, if any, on this grid. Where no `field` is given, a smaller one is enlarged, with a report.
    /// Returns the notices on the file of the mask, which are also reported.
    ///
    /// # Errors
    /// Where the grid is out of range or not one of the mask, or the mask cannot be read.
    pub fn put_mask(
        &self,
        design: &mut Design,
        mask: Option<&MaskSource>,
        scene: &SceneArgs,
    ) -> anyhow::Result<Vec<String>> {
        if let Some(side) = self.grid {
            check_count("--grid", side, 1..=LensletArray::MAX_SIDE)?;
        }
        let mut notices = Vec::new();
        design.encoder = match mask {
            Some(mask) => {
                let opened = open_mask(mask, design, self.grid)?;
                notices = opened.notices;
                opened.encoder
            }
            None => on_grid(design.encoder.clone(), self.grid.map(|side| (side, side)))?,
        };
        let room = design.clone().with_room();
        if scene.field.is_none() && room.field != design.field {
            let ((rows, cols), (grid_rows, grid_cols)) = (room.field, room.encoder.grid());
            report(format!(
                "field {rows} x {cols} px, as the PSF has {grid_rows} x {grid_cols} px; --field sets another"
            ));
            *design = room;
        }
        Ok(notices)
    }
}

/// A design, and the notices on the file of its mask.
pub struct NotedDesign {
    /// The design.
    pub design: Design,
    /// Sentences about the file of the mask.
    pub notices: Vec<String>,
}

/// The flag `--throughput`.
#[derive(Args, Debug)]
pub struct ThroughputArg {
    /// Throughput of the mask, the sum of its PSF: up to 1, of lenslets up to 64 [default: that of the mask; 1 keeps the light of a
    /// diffuser and shares that of lenslets in depth].
    #[arg(long = "throughput", value_name = "T")]
    given: Option<f64>,
}

impl ThroughputArg {
    /// The design with this throughput, where one was given.
    pub fn replace_in(&self, design: &mut Design) {
        if let Some(throughput) = self.given {
            design.encoder.set_throughput(throughput);
        }
    }
}

/// Objects in front of the mask and sensor behind it.
#[derive(Args, Debug)]
pub struct SceneArgs {
    /// Objects: beads:DENSITY, beads-max:DENSITY, volume:PLANES:DENSITY, idx:FILE, cifar:FILE, images:FOLDER, or
    /// stack:FILE. FILE?axis=last&key=NAME&channel=green&frame=3 selects the part of a file.
    #[arg(long, value_name = "OBJECTS", value_parser = objects_argument())]
    objects: Option<ObjectSource>,

    /// Size of the objects, pixels: 256, or rows x cols such as 256x320, up to 1024 [default: that of the design, or 96]. Objects of
    /// stack:FILE keep their own.
    #[arg(long, value_name = "PIXELS", value_parser = field_argument)]
    field: Option<(usize, usize)>,

    /// How whole images of images:FOLDER get the size of the objects: scaled, tiled or cropped.
    #[arg(long, value_name = "HOW")]
    placement: Option<Placement>,

    /// Pitch of the sensor's pixels, micrometres, for physical scales. Information per pixel does not depend on it.
    #[arg(long, value_name = "UM")]
    pixel_pitch: Option<f64>,

    /// Mean of the objects, photons per pixel.
    #[arg(long, value_name = "PHOTONS")]
    mean_photons: Option<f64>,

    /// Background, photons per pixel.
    #[arg(long, value_name = "PHOTONS")]
    bias: Option<f64>,

    /// Noise of the sensor: shot, read:SIGMA, shot+read:SIGMA or none.
    #[arg(long)]
    pub(super) noise: Option<Noise>,
}

impl DesignArgs {
    /// Refuses `outputs` that would overwrite an input file of `design`; a design file with equal content may be rewritten.
    pub fn check_inputs_stay(&self, outputs: &[PathBuf], design: &Design) -> anyhow::Result<()> {
        check_inputs_stay(&self.files(design), outputs, ("--out", Some(design)))
    }

    /// Input files of `design`.
    pub fn files(&self, design: &Design) -> Vec<PathBuf> {
        files_of([self.design.clone(), self.mask.as_ref().and_then(MaskSource::file)], &design.objects)
    }

    /// The design of the flags, with objects and sensor replaced by those of `scene`.
    pub fn design(&self, scene: &SceneArgs) -> anyhow::Result<Design> {
        Ok(self.noted_design(scene)?.design)
    }

    /// As [`DesignArgs::design`], with the notices on the file of the mask, which are also reported.
    pub fn noted_design(&self, scene: &SceneArgs) -> anyhow::Result<NotedDesign> {
        let mut design = match &self.design {
            Some(path) => open_design(path)?,
            None => Design::default(),
        };
        if let Some(seed) = self.seed {
            design.seed = seed;
        }
        scene.replace_in(&mut design);
        let notices = self.grid.put_mask(&mut design, self.mask.as_ref(), scene)?;
        self.throughput.replace_in(&mut design);
        design.check()?;
        Ok(NotedDesign { design, notices })
    }
}

/// Input files: those `named` (standard input left out) and those of the objects.
pub fn files_of(named: [Option<PathBuf>; 2], objects: &ObjectSource) -> Vec<PathBuf> {
    let named = named.into_iter().flatten().filter(|input| input != Path::new("-"));
    named.chain(objects.files()).collect()
}

/// Refuses a folder that holds the design of another mask and one of `files`, which would then be attributed to this mask.
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

/// Refuses `outputs` (named by `flag`) that would overwrite one of the `inputs`. A design file with the content of `design` may
/// be rewritten.
pub fn check_inputs_stay(
    inputs: &[PathBuf],
    outputs: &[PathBuf],
    (flag, design): (&str, Option<&Design>),
) -> anyhow::Result<()> {
    // A file that does not exist yet overwrites nothing.
    let outputs: Vec<_> = outputs.iter().filter_map(|output| Some((output.canonicalize().ok()?, output))).collect();
    if outputs.is_empty() {
        return Ok(());
    }
    for input in inputs {
        let Ok(read) = input.canonicalize() else { continue };
        let Some((_, output)) = outputs.iter().find(|(place, _)| *place == read) else { continue };
        let stays = output.ends_with(DESIGN_FILE) && design.is_some() && Design::open(input).ok().as_ref() == design;
        if !stays {
            bail!("{}: a file of the result would overwrite this input; choose another {flag}", input.display());
        }
    }
    Ok(())
}

/// Reads a design from a file, or from standard input for the path `-`.
pub fn open_design(path: &Path) -> anyhow::Result<Design> {
    if path != Path::new("-") {
        return Ok(Design::open(path)?);
    }
    let value = serde_json::from_reader(std::io::stdin().lock().take(LARGEST_DESIGN))
        .with_context(|| format!("{STANDARD_INPUT}: expected the JSON of a design"))?;
    Ok(Design::from_value(value, STANDARD_INPUT)?)
}

impl SceneArgs {
    /// Replaces the entries of a design that were given as flags.
    pub fn replace_in(&self, design: &mut Design) {
        if let Some(objects) = &self.objects {
            design.objects = objects.clone();
        }
        design.field = self.field.unwrap_or(design.field);
        design.placement = self.placement.unwrap_or(design.placement);
        design.pixel_pitch_um = self.pixel_pitch.or(design.pixel_pitch_um);
        design.mean_photons = self.mean_photons.unwrap_or(design.mean_photons);
        design.bias_photons = self.bias.unwrap_or(design.bias_photons);
        design.noise = self.noise.unwrap_or(design.noise);
    }
}
