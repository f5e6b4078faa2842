//! Magnetic fields and wrenches, and the kinematics of the arm that carries a magnet.
//!
//! Everything here is in double precision and in SI. Sums run in a fixed order, so that results do
//! not depend on the number of threads.

mod axial;
mod elliptic;
pub mod handle;
mod map;
mod multipole;
mod number;
pub mod sources;
