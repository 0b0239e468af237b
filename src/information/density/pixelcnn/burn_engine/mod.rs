//! The engine on a device of burn: the same network as burn modules, its gradients by burn's automatic
//! differentiation.

mod device;
mod engine;
mod mixture;
mod network;

pub(crate) use device::{guarded, open_device};
pub(super) use engine::BurnEngine;
