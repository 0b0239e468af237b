//! Training data of the pretrained weights: masks of all kinds imaging beads and drawn images, under three kinds of noise.

#![allow(dead_code, unused_imports, reason = "each of the two examples uses one kind of training data")]

mod channels;
mod images;
mod masks;
mod scenes;
mod weights_file;

pub use channels::training_channel;
pub use scenes::training_scene;
pub use weights_file::{Arguments, WeightsFile};
