//! Measures of the views of cameras.

pub mod coverage;
pub mod point_coverage;
