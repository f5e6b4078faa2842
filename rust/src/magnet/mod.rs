//! Magnetic fields of sources and wrenches on magnets.
//!
//! All values are in double precision and in SI units. Sums have a fixed order, so that results do
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
