//! Writers of recordings: PNG files.

pub mod png;
