//! Errors of object sets, each one sentence.

use crate::formats::FormatError;

use super::Split;

/// Error of opening or drawing objects.
#[derive(Debug, thiserror::Error)]
pub enum ObjectError {
    /// The text does not name objects.
    #[error("objects \"{text}\": expected {expected}, found {found}")]
    Source {
        /// The text.
        text: String,
        /// The expected text, with the choices.
        expected: String,
        /// What is wrong with it.
        found: String,
    },
    /// A setting is outside its range.
    #[error("object option {name}: expected {expected}, found {found}")]
    Option {
        /// The setting.
        name: &'static str,
        /// Its range.
        expected: String,
        /// Its value.
        found: String,
    },
    /// A file could not be read or holds pixels that cannot be photons.
    #[error(transparent)]
    File(#[from] FormatError),
    /// The set is too small to be split.
    #[error(
        "{split} objects of {source_name}: expected at least one image, found none among {images}; add images or use all of them"
    )]
    EmptySplit {
        /// The requested part.
        split: Split,
        /// The source as text.
        source_name: String,
        /// Number of base images in the whole set.
        images: usize,
    },
    /// The requested objects exceed the memory.
    #[error("expected objects that fit into memory, found {count} of {planes} x {rows} x {cols} px; use fewer")]
    TooMany {
        /// Number of objects.
        count: usize,
        /// Planes of each object.
        planes: usize,
        /// Rows, px.
        rows: usize,
        /// Columns, px.
        cols: usize,
    },
    /// The progress cancelled.
    #[error("loading the objects was cancelled")]
    Cancelled,
}
