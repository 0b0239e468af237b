//! What a decoder makes of the shown measurement, after every edit, and how good it is on a test set.

pub mod computation;
pub mod networks;
pub mod queue;
pub mod reconstructor;
