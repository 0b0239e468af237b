//! An array of a file as stored.

use super::{Samples, Understood};

/// An array of a file before its axes have a meaning.
pub(super) struct RawArray {
    /// Its axes.
    pub(super) shape: Vec<usize>,
    /// Its values, row-major.
    pub(super) samples: Samples,
    /// Name, number type and notes.
    pub(super) understood: Understood,
}
