//! Compiled core of vrcaps: rendering, contact and recording with a wall of triangles.

// Loops over lanes index several arrays at once; iterators would hide that from the vectorizer.
#![allow(clippy::needless_range_loop)]

mod actuation;
mod camera_pipeline;
mod cpu;
mod lumen;
mod magnet;
mod mesh;
mod metrics;
mod mucosa;
mod pool;
mod poses;
mod recording;
mod render;
mod simd;
mod tissue;
mod wall;
mod waves;
mod world;

use pyo3::prelude::*;

#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    pool::watch_forks();
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add_function(wrap_pyfunction!(mucosa::bake_mucosa, m)?)?;
    m.add_class::<wall::Wall>()?;
    m.add_class::<tissue::fem::layer::FemLayer>()?;
    m.add_class::<actuation::arm_chain::ArmChain>()?;
    m.add_class::<actuation::arm_with_payload::ArmWithPayload>()?;
    m.add_class::<actuation::robot_actuator::RobotActuator>()?;
    m.add_class::<magnet::field_sources::FieldSources>()?;
    m.add_function(wrap_pyfunction!(actuation::magnet_pose_solver::solve_magnet_pose, m)?)?;
    m.add_function(wrap_pyfunction!(actuation::rotation::rotate_by_vector, m)?)?;
    m.add_function(wrap_pyfunction!(actuation::rotation::rotation_vector_rows, m)?)?;
    m.add_function(wrap_pyfunction!(actuation::reference::advance_reference, m)?)?;
    m.add_class::<world::binding::World>()?;
    m.add_function(wrap_pyfunction!(world::batch::step_worlds, m)?)?;
    m.add_function(wrap_pyfunction!(world::batch::world_states, m)?)?;
    m.add_function(wrap_pyfunction!(world::batch::worlds_inside, m)?)?;
    m.add_function(wrap_pyfunction!(world::batch::settle_worlds, m)?)?;
    m.add_class::<lumen::particles::Particles>()?;
    m.add_function(wrap_pyfunction!(lumen::particles::terminal_speed, m)?)?;
    m.add_function(wrap_pyfunction!(lumen::pushed_aside::around_capsule, m)?)?;
    m.add_class::<render::lumen::Contents>()?;
    m.add_class::<render::scene::Scene>()?;
    m.add_class::<render::texture::Texture>()?;
    m.add_class::<render::ray_table::RayTable>()?;
    m.add_class::<render::radiosity::Radiosity>()?;
    m.add_function(wrap_pyfunction!(render::frame::render, m)?)?;
    m.add_function(wrap_pyfunction!(render::batch::render_batch, m)?)?;
    m.add_function(wrap_pyfunction!(render::forward_scatter::scatter_forward, m)?)?;
    m.add_function(wrap_pyfunction!(render::medium::immerse, m)?)?;
    m.add_function(wrap_pyfunction!(render::villi::raise_villi, m)?)?;
    m.add_function(wrap_pyfunction!(render::path::subsurface::walk_tissue, m)?)?;
    m.add_function(wrap_pyfunction!(render::channels::encode_srgb, m)?)?;
    m.add_function(wrap_pyfunction!(mesh::self_intersection::intersecting_triangles, m)?)?;
    m.add_function(wrap_pyfunction!(mesh::turned::turned_triangles, m)?)?;
    m.add_function(wrap_pyfunction!(mesh::texels::covered_texels, m)?)?;
    m.add_function(wrap_pyfunction!(waves::sum_wave_tables, m)?)?;
    m.add_function(wrap_pyfunction!(metrics::coverage::mark_seen, m)?)?;
    m.add_function(wrap_pyfunction!(wall::distances::wall_distances, m)?)?;
    m.add_class::<metrics::point_coverage::WallPoints>()?;
    m.add_class::<metrics::point_coverage::DirectionTable>()?;
    m.add_function(wrap_pyfunction!(metrics::point_coverage::mark_points, m)?)?;
    m.add_function(wrap_pyfunction!(recording::png::write_pngs, m)?)?;
    m.add_function(wrap_pyfunction!(recording::png::encode_pngs, m)?)?;
    m.add_function(wrap_pyfunction!(recording::png::decode_pngs, m)?)?;
    m.add_function(wrap_pyfunction!(recording::png::quantize, m)?)?;
    m.add_function(wrap_pyfunction!(recording::png::read_png, m)?)?;
    camera_pipeline::register(m)?;
    let testing = PyModule::new(m.py(), "testing")?;
    camera_pipeline::register_testing(&testing)?;
    testing.add_function(wrap_pyfunction!(pool::forbid_global_pool, &testing)?)?;
    m.add_submodule(&testing)?;
    m.add_function(wrap_pyfunction!(cpu::cpu_features, m)?)?;
    m.add_function(wrap_pyfunction!(pool::num_threads, m)?)?;
    Ok(())
}
