//! What recordings write: PNG files.

pub mod png;
