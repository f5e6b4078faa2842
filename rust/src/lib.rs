//! The compiled core of vrcaps: seeing and touching a wall of triangles, and writing what was seen.

// Loops over lanes index several arrays at once; iterators would hide that from the vectoriser.
#![allow(clippy::needless_range_loop)]

mod bvh;
mod lanes;
mod query;
mod tile;
mod visibility;
mod wall;

use pyo3::prelude::*;

#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add_class::<wall::Wall>()?;
    Ok(())
}
