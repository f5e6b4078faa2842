//! What lens and sensor make of an image: each stage a file, and a function of arrays to be used by
//! itself; `chain` puts them in order.
//!
//! Images are linear, and three planes [3 h w], so that loops over a row become vector code. Every
//! stage works row by row, and no row depends on another's result: the same bytes on any number of
//! threads.

mod bayer;
mod bloom;
mod chain;
mod cosine;
mod defocus;
mod dome;
mod field;
mod flow;
mod given;
mod jpeg;
mod motion;
mod noise;
mod planes;
mod tables;

use pyo3::prelude::*;

/// Adds the stages to the module.
pub fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<chain::CameraStages>()?;
    m.add_function(wrap_pyfunction!(motion::blur_motion, m)?)?;
    m.add_function(wrap_pyfunction!(flow::flow_by_rays, m)?)?;
    m.add_function(wrap_pyfunction!(planes::scale_planes, m)?)?;
    m.add_function(wrap_pyfunction!(planes::shade_planes, m)?)?;
    m.add_function(wrap_pyfunction!(planes::develop, m)?)?;
    m.add_function(wrap_pyfunction!(defocus::defocus, m)?)?;
    m.add_function(wrap_pyfunction!(dome::through_dome, m)?)?;
    m.add_function(wrap_pyfunction!(bloom::bloom, m)?)?;
    m.add_function(wrap_pyfunction!(noise::standard_normal, m)?)?;
    m.add_function(wrap_pyfunction!(noise::read_sensor, m)?)?;
    m.add_function(wrap_pyfunction!(bayer::demosaic, m)?)?;
    m.add_function(wrap_pyfunction!(jpeg::jpeg, m)?)?;
    m.add_function(wrap_pyfunction!(jpeg::jpeg_bytes, m)?)?;
    m.add_function(wrap_pyfunction!(jpeg::jpeg_quality, m)?)?;
    Ok(())
}
