//! Measures of what cameras see.

pub mod coverage;
pub mod point_coverage;
