//! Annealed importance sampling (AIS): lower and upper bounds on the information about beads.
//!
//! Upper bound: `I(X; Y) = E[log p(y | x) - log p(y)]`. Annealing from the decoder's posterior estimates `p(y)` without
//! bias. By Jensen's inequality the log of the estimate is too small on average, so the information is too large, for any
//! decoder and any number of temperatures. The sites are annealed in groups, each given the beads of the others. For
//! independent beads `I(X; Y) <= sum over groups of I(X_g; Y | X of the others)`, because
//! `I(X_g; Y | X of earlier groups) <= I(X_g; Y, X of later groups | X of earlier groups) = I(X_g; Y | X of the others)`.
//! One group gives the information itself.
//!
//! Lower bound: the reverse chain from the true beads is a decoder with hidden variables (Agakov and Barber 2004;
//! Salimans, Kingma and Welling 2015), so `I >= E[log p(y | x) - log w]` with its weight w. Without intermediate
//! temperatures it is the bound of the factorised decoder.

pub(in crate::information) mod bound;
pub(in crate::information) mod chain;
pub(in crate::information) mod checkpoint;
pub(in crate::information) mod light;
pub(in crate::information) mod posterior;
pub(in crate::information) mod progress;
pub(in crate::information) mod proposals;
pub(in crate::information) mod state;
#[cfg(test)]
mod tests;
