//! Gut wall as a layer of finite elements, stepped by implicit Euler.
//!
//! Python meshes and assembles once; this module runs in every step. All values are in double
//! precision and in SI units. One thread steps one layer: results do not depend on the number of
//! threads.

mod elements;
pub mod embedding;
mod factor;
pub mod layer;
mod minimize;
mod sparse;
pub mod split_step;

/// Result of a step, with an error message for the user.
pub type Outcome<T> = Result<T, &'static str>;
