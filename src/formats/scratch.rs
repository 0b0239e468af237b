//! A folder for the images of a test.

use std::path::{Path, PathBuf};

use ndarray::{ArrayD, IxDyn};

use super::write_array;

/// A folder that is deleted with this value.
pub(crate) struct Scratch(tempfile::TempDir);

impl Scratch {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    /// Writes an array of this shape, whose value at each index in memory is that of `value`.
    pub(crate) fn write(&self, name: &str, shape: &[usize], value: impl Fn(usize) -> f32) -> PathBuf {
        let path = self.0.path().join(name);
        let values = (0..shape.iter().product::<usize>()).map(value).collect();
        write_array(&path, ArrayD::from_shape_vec(IxDyn(shape), values).unwrap().view()).unwrap();
        path
    }
}
