//! Lenslet Studio.
fn main() {}
