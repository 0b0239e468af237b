//! The library against known answers, earlier files, broken files and, where those are available, real data.
//!
//! One program holds these tests, because each program of its own takes its time to build.

mod broken_files;
mod causal_fit;
mod crash;
mod decoder;
mod design_files;
mod design_gradient;
mod golden;
mod information;
mod known_cases;
mod known_truths;
mod object_sets;
mod optimizer;
mod pixelcnn;
mod real_data;
mod reference;
mod sizes;
mod study_stream;
mod throughput;
mod undo;
