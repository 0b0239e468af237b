//! Bounds from either side by following the posterior of the beads, measurement by measurement.
//!
//! From above: `I(X; Y) = E[log p(y | x) - log p(y)]`, and annealing from a guess of the decoder estimates `p(y)` without
//! bias, so by Jensen's inequality its log is too small on average and the information too large, for any decoder and any
//! number of steps. All sites at once are hard to anneal, so they are asked for in groups, each given the beads of the others:
//! for independent beads `I(X; Y) <= sum over groups of I(X_g; Y | X of the others)`, because
//! `I(X_g; Y | X of earlier groups) <= I(X_g; Y, X of later groups | X of earlier groups) = I(X_g; Y | X of the others)`.
//! One group is the information itself, groups of one site each are what the ceiling bounds.
//!
//! From below: the same walk backwards from the true beads is a decoder with hidden variables (Agakov and Barber 2004;
//! Salimans, Kingma and Welling 2015), so `I >= E[log p(y | x) - log w]` with its ratio w; without steps between guess and
//! posterior it is the bound of the factorised decoder.

pub(in crate::information) mod bound;
pub(in crate::information) mod chain;
pub(in crate::information) mod checkpoint;
pub(in crate::information) mod light;
pub(in crate::information) mod progress;
pub(in crate::information) mod proposals;
pub(in crate::information) mod state;
#[cfg(test)]
mod tests;
