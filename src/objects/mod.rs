//! Object sets: random beads, mosaics of small images, whole images; in photons per pixel.
//!
//! An [`ObjectSource`] names the objects, [`ObjectSet::open`] loads what must be loaded, and
//! [`ObjectSet::objects`] draws as many as are wanted, the same ones for the same seed on any number of threads.

mod autocovariance;
mod beads;
mod clean;
mod error;
mod load;
mod mosaic;
mod set;
mod source;
mod split;
mod whole;

pub use beads::BeadPrior;
pub use error::ObjectError;
pub use set::{ObjectOptions, ObjectSet, PlacedPicture, Progress};
pub use source::ObjectSource;
pub use split::Split;
