//! The items that a user of the library needs: designs, objects, measurements, estimates, bounds and the optimizer.
//!
//! ```
//! use lenslet_studio::prelude::*;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // Two lenslets image beads under shot noise.
//! let design = Design { encoder: Encoder::Lenslets(heuristic_layout(2)), ..Design::default() };
//! let request = EstimateRequest::new(Estimator::GaussianStationary).with_patch(8, 8).with_patches(400, 100);
//! let result = estimate(&design, &request, &mut CancelToken::new())?;
//! assert!(result.bits_per_pixel > 0.0);
//! # Ok(())
//! # }
//! ```

// Designs and layouts.
pub use crate::forward::Design;
pub use crate::optics::{Encoder, Lenslet, LensletArray, Limits, heuristic_layout, import_psf, random_layout};

// Objects, measurements and image files.
pub use crate::formats::{read_stack, write_array};
pub use crate::forward::{ForwardModel, Simulated};
pub use crate::objects::{ObjectOptions, ObjectSet, ObjectSource};
pub use crate::sensor::Noise;

// Cancellation, and progress that nobody reads.
pub use crate::progress::CancelToken;

// Estimates and bounds.
pub use crate::evaluation::{Calibration, EstimateRequest, MeasuredImages, MeasuredSource, estimate};
pub use crate::information::{Bracket, Estimate, Estimator, NamedBound};

// The optimizer.
pub use crate::design::{IdealOptimizer, IdealSettings, Objective, Preset};
