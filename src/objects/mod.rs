//! Object sets in photons per pixel: random beads, mosaics of small images, whole images.
//!
//! An [`ObjectSource`] names the objects and [`ObjectSet::open`] loads its files. [`ObjectSet::objects`] draws any number
//! of objects; the same seed gives the same objects on any number of threads.

mod autocovariance;
mod beads;
mod clean;
mod error;
mod load;
mod mosaic;
mod placement;
mod set;
mod source;
mod split;
mod whole_images;

pub use beads::BeadPrior;
pub use error::ObjectError;
pub use placement::Placement;
pub use set::{ObjectOptions, ObjectSet, PlacedImage, ReadProgress};
pub use source::ObjectSource;
pub use split::Split;
