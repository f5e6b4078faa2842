//! The gut wall as a layer of finite elements, stepped by implicit Euler.
//!
//! Meshing and assembly happen once, in Python; what is here happens every step. Everything is in
//! double precision and in SI units. One thread steps one layer, so that results do not depend on
//! the number of threads.

mod elements;
pub mod embedding;
mod factor;
pub mod layer;
mod minimize;
mod sparse;
pub mod split_step;

/// Result of a step; the error is in words for the user.
pub type Outcome<T> = Result<T, &'static str>;
