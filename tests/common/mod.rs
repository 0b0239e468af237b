//! Measurements of known information, on which the estimators are tested.

#![allow(dead_code, reason = "each test program uses a part of it")]

pub mod known_truths;
pub mod stream;
