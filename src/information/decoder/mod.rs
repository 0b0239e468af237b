//! Lower bounds on the information about beads, by a trained decoder.
//!
//! For any conditional distribution q of objects given measurements, `I(O; Y) >= H(O) - E[-log2 q(o | y)]` (Barber
//! and Agakov 2003). Object pixels hold a bead independently with probability p, so `H(O)` is known. Only object
//! pixels whose light reaches the patch count. The decoder is an unrolled iteration. From its current probabilities
//! it predicts mean and variance of every pixel and back-projects the residual to the object pixels. A small
//! convolutional network then corrects its logits.

pub(in crate::information) mod channel;
pub(in crate::information) mod features;
pub(in crate::information) mod file;
pub(in crate::information) mod fit;
pub(in crate::information) mod gradient;
pub(in crate::information) mod immse_gradient;
pub(in crate::information) mod information_gain;
pub(in crate::information) mod kind;
pub(in crate::information) mod layers;
pub(in crate::information) mod lower_bound;
pub(in crate::information) mod pass;
pub(in crate::information) mod pretrained;
pub(in crate::information) mod pretrained_bound;
pub(in crate::information) mod problem;
pub(in crate::information) mod samples;
pub(in crate::information) mod update;
