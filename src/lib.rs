//! Design lensless cameras by the information their measurements carry.
//!
//! A lensless camera puts a thin mask of small lenses in front of a sensor. How good a mask is for a kind of
//! scene is told, before any decoder is chosen, by the mutual information between scenes and noisy measurements,
//! in bits per pixel.
//!
//! # The house
//! Modules stand on floors and import only from floors below their own (`tests/architecture.rs` reads the imports):
//!
//! | floor | modules | hold |
//! |---|---|---|
//! | -1 | [`plural`], [`seeds`] | counts beside their words, for the sentences of all floors |
//! | 0 | [`formats`] | array and picture files, safe writing |
//! | 1 | [`optics`], [`objects`], [`sensor`], [`sparsity`] | point spread functions; object sets; measurements; Tamura coefficient |
//! | 1 | [`nn`] | building blocks of neural networks on the CPU; knows no optics |
//! | 2 | [`forward`] | the forward model: objects, mask and sensor |
//! | 3 | [`information`] | entropies, Gaussian models, ceiling, intervals, the estimate |
//! | 4 | [`design`] | the gradient of information by the mask |
//! | 4 | [`studies`] | scenes of known information, for tests of the estimators |
//! | 6 | [`workbench`] | the open design, commands, the worker, exports |
//! | 7 | `studio`, `cli` | window, command line |
//!
//! # Conventions
//! - Images are `ndarray` arrays of shape (rows, cols), row 0 at the top; stacks are (n, rows, cols); volumes are
//!   (n, planes, rows, cols).
//! - Coordinates are pixels, (x, y) = (column, row), pixel centres at integers, (0, 0) the centre of the top-left pixel.
//! - Point spread functions sum to 1. Objects and measurements are in photons per pixel. Information is in bits per pixel.
//! - Images are `f32`; entropies, means and other long sums are `f64`.
//! - Every random draw has an explicit seed; the generator is ChaCha, one stream per image or patch, so results do
//!   not depend on the number of threads.

#[cfg(feature = "cli")]
pub mod cli;
pub mod design;
pub mod evaluation;
pub mod formats;
pub mod forward;
pub mod information;
pub mod nn;
pub mod objects;
pub mod optics;
pub mod plural;
pub mod seeds;
pub mod sensor;
pub mod sparsity;
pub mod studies;
#[cfg(feature = "studio")]
pub mod studio;
pub mod workbench;
