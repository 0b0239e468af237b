//! Tooltips that several panels share.

/// What lenslets are counted, for people.
pub const COUNTS: &str = "Dark lenslets are left out, and those on one spot are taken for one. Effective: as many equal lenslets would \
                          spread the light alike";
