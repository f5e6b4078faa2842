//! How the capsule moves: a rigid body on a soft wall.
//!
//! Everything here is in double precision, in metres, kilograms and seconds, about the wall's
//! centre. One thread steps one world, so that results do not depend on the number of threads.

mod barrier;
pub mod body;
mod contact;
mod drag;
mod exchange;
mod foundation;
mod held;
mod magnets;
mod march;
mod near;
mod near_layer;
mod parameters;
mod patch;
mod quick;
mod soft_wall;
pub mod solve;
mod step;
mod wall_load;
pub mod world;
