//! Contents of the lumen: spheres, and how particles and bubbles move.

mod capsule;
mod drag;
mod particle;
pub mod particles;
pub mod pushed_aside;
pub mod spheres;
mod step_inputs;
