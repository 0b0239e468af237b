//! Commands: all changes of a design, as one enum. Menu, canvas, table and command line send nothing else.

use std::sync::Arc;

use thiserror::Error;

use crate::forward::{Design, DesignError};
use crate::objects::{ObjectSource, Placement};
use crate::optics::{Encoder, Lenslet, LensletArray, Limits};
use crate::plural::counted;
use crate::sensor::Noise;

/// A change of the open design.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Adds a lenslet at the end of the array.
    AddLenslet(Lenslet),
    /// Deletes lenslets by index.
    DeleteLenslets(Vec<usize>),
    /// Replaces lenslets by index; `what` is the parameter that the gesture changes.
    ChangeLenslets {
        /// The parameter.
        what: LensletChange,
        /// Indices and their new lenslets.
        lenslets: Vec<(usize, Lenslet)>,
    },
    /// Replaces the encoder; `name` identifies the new one ("9 heuristic lenslets").
    ReplaceEncoder {
        /// Name in the menu and the log.
        name: String,
        /// The encoder.
        encoder: Encoder,
    },
    /// Replaces the design, scene and sensor included; `name` identifies the new one.
    ReplaceDesign {
        /// Name in the menu and the log.
        name: String,
        /// The design.
        design: Arc<Design>,
    },
    /// Changes the throughput of the mask.
    SetThroughput(f64),
    /// Images other objects.
    SetObjects(ObjectSource),
    /// Scales the objects to another mean, photons per pixel.
    SetMeanPhotons(f64),
    /// Changes the background, photons per pixel.
    SetBias(f64),
    /// Changes the noise.
    SetNoise(Noise),
    /// Draws other objects, noise and patches.
    SetSeed(u64),
    /// Changes the manufacturing limits.
    SetLimits(Limits),
    /// Images objects of another size, (rows, cols) in pixels.
    SetField((usize, usize)),
    /// Brings whole images to the size of the field in another way.
    SetPlacement(Placement),
    /// Puts the mask on a square PSF grid of this side in pixels. Positions scale with the grid, widths do not. A field that is smaller
    /// than the grid is enlarged.
    SetGrid(usize),
    /// Sets or removes the pitch of the sensor's pixels, micrometres.
    SetPixelPitch(Option<f64>),
}

/// The parameter that a gesture on lenslets changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LensletChange {
    /// The centre.
    Position,
    /// The spot.
    Width,
    /// The share of light.
    Weight,
    /// The plane in focus.
    Plane,
}

/// Reasons why a command was refused; the design stays as it was.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CommandError {
    /// The command edits lenslets and there are none.
    #[error("{0} has no lenslets to edit; choose a lenslet preset first")]
    NoLenslets(String),
    /// An index that no lenslet has.
    #[error("there is no lenslet {number}; the mask has {count}")]
    Index {
        /// Number of the lenslet, counted from 1.
        number: usize,
        /// Number of lenslets in the array.
        count: usize,
    },
    /// The pixels of the mask are given.
    #[error("the PSF grid of {0} is that of its image; resample the image when it is imported")]
    GivenGrid(String),
    /// The mask on view is one of the run, and the open design has changed since the run was started.
    #[error(
        "a mask of the run is shown, and the design has changed since the run was started; open the mask as a design of its \
         own to edit it"
    )]
    OfRun,
    /// The changed design could not be computed.
    #[error(transparent)]
    Design(#[from] DesignError),
}

impl Command {
    /// Description of the command, for menu and log.
    pub fn label(&self) -> String {
        let several = |verb: &str, count: usize| match count {
            1 => format!("{verb} lenslet"),
            count => format!("{verb} {}", counted(count, "lenslet")),
        };
        match self {
            Self::AddLenslet(_) => "Add lenslet".into(),
            Self::DeleteLenslets(indices) => several("Delete", indices.len()),
            Self::ChangeLenslets { what, lenslets } => match what {
                LensletChange::Position => several("Move", lenslets.len()),
                LensletChange::Width => several("Change width of", lenslets.len()),
                LensletChange::Weight => several("Change weight of", lenslets.len()),
                LensletChange::Plane => several("Refocus", lenslets.len()),
            },
            Self::ReplaceEncoder { name, .. } => format!("Use {name}"),
            Self::ReplaceDesign { name, .. } => format!("Open {name}"),
            Self::SetThroughput(throughput) => format!("Set throughput to {throughput}"),
            Self::SetObjects(source) => format!("Image {source}"),
            Self::SetMeanPhotons(photons) => format!("Set mean to {}", counted(*photons, "photon")),
            Self::SetBias(photons) => format!("Set background to {}", counted(*photons, "photon")),
            Self::SetNoise(noise) => format!("Set noise to {noise}"),
            Self::SetSeed(seed) => format!("Set seed to {seed}"),
            Self::SetLimits(_) => "Change limits".into(),
            Self::SetField((rows, cols)) => format!("Set field to {rows} x {cols} px"),
            Self::SetPlacement(placement) => format!("Use {placement} images"),
            Self::SetGrid(side) => format!("Set PSF grid to {side} px"),
            Self::SetPixelPitch(Some(pitch)) => format!("Set pixel pitch to {pitch} \u{b5}m"),
            Self::SetPixelPitch(None) => "Remove pixel pitch".into(),
        }
    }

    /// Whether the command edits the mask: lenslets, throughput or grid.
    pub fn edits_mask(&self) -> bool {
        matches!(
            self,
            Self::AddLenslet(_)
                | Self::DeleteLenslets(_)
                | Self::ChangeLenslets { .. }
                | Self::SetThroughput(_)
                | Self::SetGrid(_)
        )
    }

    /// Whether the command keeps the lenslets, at most moved or changed, so that indices mean the same ones.
    pub fn keeps_lenslets(&self) -> bool {
        !matches!(
            self,
            Self::AddLenslet(_) | Self::DeleteLenslets(_) | Self::ReplaceEncoder { .. } | Self::ReplaceDesign { .. }
        )
    }

    /// Kind of the command. Successive commands of one kind form one step of a gesture. None where each is a step of its own.
    pub fn kind(&self) -> Option<String> {
        Some(match self {
            Self::ChangeLenslets { what, lenslets } => {
                let indices: Vec<usize> = lenslets.iter().map(|(index, _)| *index).collect();
                format!("{what:?} {indices:?}")
            }
            Self::AddLenslet(_)
            | Self::DeleteLenslets(_)
            | Self::ReplaceEncoder { .. }
            | Self::ReplaceDesign { .. } => return None,
            // The density is dragged and typed; another kind of objects is chosen.
            Self::SetObjects(source) => format!("objects {:?}", std::mem::discriminant(source)),
            Self::SetThroughput(_) => "throughput".into(),
            Self::SetMeanPhotons(_) => "mean photons".into(),
            Self::SetBias(_) => "background".into(),
            Self::SetNoise(_) => "noise".into(),
            Self::SetSeed(_) => "seed".into(),
            Self::SetLimits(_) => "limits".into(),
            Self::SetField(_) => "field".into(),
            Self::SetPlacement(_) => "placement".into(),
            Self::SetGrid(_) => "grid".into(),
            Self::SetPixelPitch(_) => "pixel pitch".into(),
        })
    }

    /// The design after this command.
    ///
    /// # Errors
    /// [`CommandError`] where the result would not be a design.
    pub fn applied_to(&self, design: &Design) -> Result<Design, CommandError> {
        let mut changed = design.clone();
        match self {
            Self::AddLenslet(lenslet) => lenslets_of(&mut changed)?.lenslets.push(*lenslet),
            Self::DeleteLenslets(indices) => {
                let array = lenslets_of(&mut changed)?;
                for &index in indices {
                    check_index(array, index)?;
                }
                let mut index = 0;
                array.lenslets.retain(|_| {
                    index += 1;
                    !indices.contains(&(index - 1))
                });
            }
            Self::ChangeLenslets { lenslets, .. } => {
                let array = lenslets_of(&mut changed)?;
                for &(index, lenslet) in lenslets {
                    check_index(array, index)?;
                    array.lenslets[index] = lenslet;
                }
            }
            Self::ReplaceEncoder { encoder, .. } => changed.encoder = encoder.clone(),
            Self::ReplaceDesign { design, .. } => changed.clone_from(design),
            Self::SetThroughput(throughput) => changed.encoder.set_throughput(*throughput),
            Self::SetObjects(source) => changed.objects = source.clone(),
            Self::SetMeanPhotons(photons) => changed.mean_photons = *photons,
            Self::SetBias(photons) => changed.bias_photons = *photons,
            Self::SetNoise(noise) => changed.noise = *noise,
            Self::SetSeed(seed) => changed.seed = *seed,
            Self::SetLimits(limits) => changed.limits = *limits,
            Self::SetField(field) => changed.field = *field,
            Self::SetPlacement(placement) => changed.placement = *placement,
            Self::SetGrid(side) => {
                let given = || CommandError::GivenGrid(design.encoder.describe());
                changed.encoder = changed.encoder.on_grid(*side, *side).ok_or_else(given)?;
            }
            Self::SetPixelPitch(pitch) => changed.pixel_pitch_um = *pitch,
        }
        // A field that is typed too small is refused; other changes make room.
        if !matches!(self, Self::SetField(_)) {
            changed = changed.with_room();
        }
        changed.check()?;
        Ok(changed)
    }
}

fn lenslets_of(design: &mut Design) -> Result<&mut LensletArray, CommandError> {
    let name = design.encoder.describe();
    match &mut design.encoder {
        Encoder::Lenslets(array) => Ok(array),
        Encoder::Diffuser(_) | Encoder::Image(_) => Err(CommandError::NoLenslets(name)),
    }
}

fn check_index(array: &LensletArray, index: usize) -> Result<(), CommandError> {
    let count = array.lenslets.len();
    if index < count { Ok(()) } else { Err(CommandError::Index { number: index + 1, count }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deleting_keeps_the_others_in_order() {
        let design = Design::default();
        let before = design.encoder.lenslets().unwrap().lenslets.clone();
        let after = Command::DeleteLenslets(vec![7, 0, 3]).applied_to(&design).unwrap();
        let expected: Vec<_> = [1, 2, 4, 5, 6, 8].map(|index| before[index]).to_vec();
        assert_eq!(after.encoder.lenslets().unwrap().lenslets, expected);
    }

    #[test]
    fn another_grid_scales_positions_and_has_room_in_the_field() {
        let design = Design::default();
        assert_eq!(Command::SetGrid(96).applied_to(&design).unwrap().field, (96, 96));
        assert_eq!(Command::SetGrid(97).applied_to(&design).unwrap().field, (291, 291));
        let large = Command::SetField((192, 200)).applied_to(&design).unwrap();
        let scaled = Command::SetGrid(64).applied_to(&large).unwrap();
        let of = |design: &Design| design.encoder.lenslets().unwrap().lenslets[0];
        assert_eq!((of(&design).x, of(&scaled).x, of(&scaled).spot), (16.0, 32.5, of(&design).spot));
        assert_eq!(Command::SetGrid(32).applied_to(&scaled).unwrap(), large);
        let refused = Command::SetField((60, 200)).applied_to(&scaled).unwrap_err().to_string();
        assert!(refused.contains("60 x 200 px; expected at least the 64 x 64 px"), "{refused}");
        let refused = Command::SetField((1025, 200)).applied_to(&scaled).unwrap_err().to_string();
        assert_eq!(refused, "field rows is 1025 px; expected 1 to 1024 px");
    }

    #[test]
    fn a_refused_command_says_why() {
        let design = Design::default();
        let all = Command::DeleteLenslets((0..9).collect());
        assert!(all.applied_to(&design).unwrap_err().to_string().contains("no lenslet"));
        let beyond = Command::DeleteLenslets(vec![9]).applied_to(&design).unwrap_err();
        assert_eq!(beyond, CommandError::Index { number: 10, count: 9 });
        let dark = Command::SetMeanPhotons(f64::NAN).applied_to(&design);
        assert!(matches!(dark, Err(CommandError::Design(DesignError::Setting { .. }))));
        let bright = Command::SetThroughput(65.0).applied_to(&design).unwrap_err().to_string();
        assert_eq!(bright, "the throughput is 65.0; expected 0.000001 to 64");
        let dim = Command::SetThroughput(0.3).applied_to(&design).unwrap();
        assert_eq!(dim.encoder, design.encoder.with_throughput(0.3));
    }
}
