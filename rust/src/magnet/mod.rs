//! Magnetic fields of sources and wrenches on magnets.
//!
//! Everything here is in double precision and in SI. Sums run in a fixed order, so that results do
//! not depend on the number of threads.

mod axial;
mod axial_field;
mod dual;
mod elliptic;
mod field_map;
pub mod field_sources;
mod multipole;
mod solids;
pub mod sources;
