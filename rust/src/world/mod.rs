//! Dynamics of the capsule: a rigid body in a soft wall.
//!
//! All values are in double precision, in meters, kilograms and seconds, relative to the wall's
//! center. One thread steps one world, so that results do not depend on the number of threads.

mod barrier;
pub mod batch;
pub mod binding;
pub mod body;
mod broad_phase;
mod condensed_layer;
mod contact;
mod contact_patch;
mod coupling_state;
mod fem_coupling;
mod friction;
mod laws;
mod magnetic_coupling;
mod parameters;
mod quasi_static;
mod series;
mod sliding;
mod soft_wall;
pub mod solve;
mod substep;
mod time_stepping;
mod wall_load;
