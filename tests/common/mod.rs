//! Measurements of known information, for tests of the estimators.

#![allow(dead_code, reason = "each test program uses a part of it")]

pub mod known_truths;
pub mod stream;
