//! Threads of the workbench, and the list of what they do.

pub mod activity;
pub mod latest;
pub mod mailbox;
pub mod threads;
