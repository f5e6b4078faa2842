//! Measures of what cameras see.

pub mod coverage;
