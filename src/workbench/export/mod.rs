//! Files for other programs: designs, stacks of measurements, records, and command lines.

pub mod colormap;
pub mod design_files;
pub mod reconstruction_files;
pub mod stacks;
