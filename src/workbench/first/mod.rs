//! Designs and scenes that the weights of the program were fitted to: masks of all kinds before beads and drawn pictures,
//! bright and dim, under all three noises.

mod channels;
mod masks;
mod pictures;
mod scenes;

pub use channels::first_channel;
pub use scenes::first_scene;
