//! The compiled core of vrcaps.

mod mucosa;

use pyo3::prelude::*;

#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add_function(wrap_pyfunction!(mucosa::bake_mucosa, m)?)?;
    Ok(())
}
