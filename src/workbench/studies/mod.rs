//! The study of the window: its folder, its cells, and the thread that computes them.

mod computation;
pub(crate) mod queue;
pub(crate) mod study_thread;
