//! Tamura coefficient.
