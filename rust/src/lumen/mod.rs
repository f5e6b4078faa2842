//! Contents of the lumen: spheres, and the motion of particles and bubbles.

mod capsule;
pub mod clump;
pub mod crossings;
mod drag;
mod particle;
mod particle_contact;
pub mod particles;
pub mod pushed_aside;
pub mod spheres;
mod step_inputs;
