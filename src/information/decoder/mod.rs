//! Lower bounds on the information about beads: what a trained decoder can tell of them from a measurement.
//!
//! For any conditional distribution q of objects given measurements, `I(O; Y) >= H(O) - E[-log2 q(o | y)]` (Barber and
//! Agakov 2003). Object pixels hold a bead independently with probability p, so `H(O)` is known, and only those whose
//! light reaches the patch count. The decoder is an unrolled iteration: from its current probabilities it predicts mean
//! and variance of every pixel, takes the residual back to the object pixels, and lets a small convolutional network
//! correct its logits.

mod bound;
mod channel;
mod draws;
mod evaluation;
mod features;
mod file;
mod first;
mod fit;
mod gradient;
mod layers;
mod pass;
mod posterior;
mod quick;
mod scene;
mod slope;
mod step;

pub use bound::{DecoderKind, LowerBound, decoder_lower_bound};
pub use channel::BeadChannel;
pub use evaluation::{decoder_savings, savings_gain};
pub use first::{FirstProgress, OnFirstStep};
pub use fit::{DecoderFit, DecoderProgress, DecoderRefit};
pub use layers::Decoder;
pub use posterior::{
    OnPosterior, PosteriorBound, PosteriorFit, PosteriorProgress, posterior_lower_bound, posterior_upper_bound,
};
pub use quick::QuickLowerBound;
pub use slope::spot_slope;
