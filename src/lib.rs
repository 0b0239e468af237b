//! Design lensless cameras by the information their measurements carry.
//!
//! A lensless camera puts a thin mask of small lenses in front of a sensor. How good a mask is for a kind of
//! scene is measured, before any decoder is chosen, by the mutual information between scenes and noisy measurements,
//! in bits per pixel. [`prelude`] holds the items that most programs need.
//!
//! # The house
//! Modules stand on floors and import only from floors below their own (`tests/architecture` reads the imports):
//!
//! | floor | modules | hold |
//! |---|---|---|
//! | 0 | [`plural`], [`percentile`], [`seeds`], [`progress`] | counts in words; percentiles; seeds of every random draw; progress and cancellation |
//! | 0 | [`formats`] | arrays, images, tables, documents; atomic writes, the writer thread, locks |
//! | 1 | [`optics`], [`objects`], [`sensor`], [`sparsity`] | point spread functions; object sets; measurements; Tamura coefficient |
//! | 1 | [`nn`] | building blocks of neural networks on the CPU; knows no optics |
//! | 2 | [`forward`], [`camera`] | the forward model: objects, mask and sensor; calibration of real sensors |
//! | 3 | [`information`] | entropies, density models, decoder, annealed importance sampling, bounds, the estimate |
//! | 4 | [`design`] | IDEAL: the mask optimized by the information of its measurements |
//! | 4 | [`reconstruction`] | objects from measurements: linear, total variation; image quality |
//! | 5 | [`evaluation`] | one design evaluated: its scene, bounds, estimates and their checkpoints |
//! | 6 | [`studies`] | a study: a grid of cells, its runner, tables and plots |
//! | 7 | [`workbench`] | the open design, commands, live estimate, estimates, runs, jobs, exports |
//! | 8 | `studio`, `cli` | window, command line |
//!
//! # Conventions
//! - Images are `ndarray` arrays of shape (rows, cols), row 0 at the top; stacks are (n, rows, cols); volumes are
//!   (n, planes, rows, cols).
//! - Coordinates are pixels, (x, y) = (column, row), pixel centres at integers, (0, 0) the centre of the top-left pixel.
//! - A point spread function (PSF) is a throughput times a kernel of sum 1. Throughput is 1 unless an aperture blocks light or
//!   lenslets in depth collect more.
//! - Objects and measurements are in photons per pixel. Information is in bits per pixel.
//! - Images are `f32`; entropies, means and other long sums are `f64`.
//! - Every random draw has an explicit seed; the generator is ChaCha, one stream per image or patch, so results do
//!   not depend on the number of threads.

pub mod camera;
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
pub mod percentile;
pub mod plural;
pub mod prelude;
pub mod progress;
pub mod reconstruction;
pub mod seeds;
pub mod sensor;
pub mod significant;
pub mod sparsity;
pub mod studies;
#[cfg(feature = "studio")]
pub mod studio;
pub mod workbench;
