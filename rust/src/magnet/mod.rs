//! Magnetic fields and wrenches, and the kinematics of the arm that carries a magnet.
//!
//! Everything here is in double precision and in SI. Sums run in a fixed order, so that results do
//! not depend on the number of threads.

pub mod aim;
pub mod arm;
mod axial;
mod capsules;
pub mod carrier;
mod chain;
mod descent;
mod elliptic;
pub mod handle;
pub mod holder;
mod inverse;
pub mod lead;
mod map;
mod multipole;
mod number;
pub mod sources;
pub mod turn;
