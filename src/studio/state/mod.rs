//! What the window shows and what its forms hold: plain data.

pub mod app_state;
pub mod locks;
