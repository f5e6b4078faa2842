//! Camera pipeline: effects of lens and sensor on an image. Each stage is a file; `stages` is their
//! registry, `pipeline` runs them in order.
//!
//! Images are linear, and three planes [3 h w], so that loops over a row become vector code. Every
//! stage works row by row, and no row depends on the result of another: outputs are bit-identical
//! on any number of threads.

pub mod bloom;
mod dct;
mod demosaic;
mod depth_of_field;
mod dome;
mod isp;
mod jpeg;
mod jpeg_tables;
mod motion_blur;
mod motion_field;
mod optical_flow;
mod pipeline;
mod planes;
mod sensor_noise;
mod stages;

use pyo3::prelude::*;

/// Adds the pipeline to the module.
pub fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<pipeline::CameraPipeline>()?;
    m.add_function(wrap_pyfunction!(optical_flow::flow_by_rays, m)?)?;
    m.add_function(wrap_pyfunction!(sensor_noise::standard_normal, m)?)?;
    Ok(())
}

/// Adds each stage separately to the module of functions that only tests call.
pub fn register_testing(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(motion_blur::motion_blur, m)?)?;
    m.add_function(wrap_pyfunction!(depth_of_field::depth_of_field, m)?)?;
    m.add_function(wrap_pyfunction!(dome::dome, m)?)?;
    m.add_function(wrap_pyfunction!(planes::chromatic_aberration, m)?)?;
    m.add_function(wrap_pyfunction!(planes::vignetting, m)?)?;
    m.add_function(wrap_pyfunction!(bloom::bloom, m)?)?;
    m.add_function(wrap_pyfunction!(sensor_noise::read_sensor, m)?)?;
    m.add_function(wrap_pyfunction!(demosaic::demosaic, m)?)?;
    m.add_function(wrap_pyfunction!(planes::develop, m)?)?;
    m.add_function(wrap_pyfunction!(isp::isp, m)?)?;
    m.add_function(wrap_pyfunction!(jpeg::jpeg, m)?)?;
    m.add_function(wrap_pyfunction!(jpeg::jpeg_bytes, m)?)?;
    m.add_function(wrap_pyfunction!(jpeg::jpeg_quality, m)?)?;
    Ok(())
}
