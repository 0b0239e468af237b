//! information.
