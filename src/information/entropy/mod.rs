//! Entropies and likelihoods of the noise, H(Y|X).

pub(in crate::information) mod likelihood;
pub(in crate::information) mod noise_entropy;
pub(in crate::information) mod poisson;
pub(in crate::information) mod poisson_gaussian;
pub(in crate::information) mod reparameterisation;
