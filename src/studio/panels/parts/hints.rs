//! Tooltips that several panels share.

/// Tooltip of lenslet counts.
pub const COUNTS: &str = "Dark lenslets are left out and coinciding ones count once; effective is the number of equally bright lenslets with the same spread of light";
