//! Short work beside the window: opening, saving and exporting, and the evaluation of every edit.

pub mod commands;
pub mod evaluator;
pub mod job;
pub mod outcome;
pub mod queue;
pub mod record;
pub mod worker;
