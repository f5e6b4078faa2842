//! Radiosity: indirect light between gather points of the wall, in real time (Goral et al. 1984).
//!
//! Gather points are about a seventh of the lumen's width apart. Their form factors are traced
//! once, at rest. In each frame the LEDs light the gather points near the camera, the radiosity is
//! solved, and each vertex interpolates the gather points around it. A pixel interpolates its
//! irradiance from the corners of its face. Gloss reflects indirect light as if it were diffuse.
//!
//! Results do not depend on earlier frames: form factors are traced on first use, from the wall at
//! rest, and adapted in each frame to the current wall.

mod deformed_transport;
mod direct_light;
mod form_factors;
mod gather_points;
mod lazy_cache;
mod patch_albedo;
mod reflectance;
mod solve;
mod stratified_lobe;
mod subsurface;

use crate::pool::detached;
use deformed_transport::Place;
use form_factors::{FormFactorRow, trace_row};
use gather_points::GatherPoints;
use lazy_cache::CachePool;
use once_cell::race::OnceBox;
use patch_albedo::PatchAlbedo;
use reflectance::Reflectance;
pub use solve::Irradiance;
pub use subsurface::SubsurfaceLight;
use subsurface::Transport;

use crate::render::scene::{Scene, SceneData};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use pyo3::prelude::*;

/// A color padded to four components for vectorization.
type Color = [f32; 4];

/// Indirect light of a wall: gather points, their reflectance and their form factors.
#[pyclass(frozen, module = "vrcaps._core")]
pub struct Radiosity {
    rest: Py<Wall>,
    gather_points: GatherPoints,
    /// Mean base color of the region that each gather point represents.
    albedo: Vec<Vec3>,
    /// One over the area of the wall that each gather point represents at rest [1/m²].
    per_area: Vec<f32>,
    reflectance: Reflectance,
    /// Threads that need a row at the same time all trace it, with identical results; none waits
    /// for another, which may not exist in a forked process.
    rows: Vec<OnceBox<FormFactorRow>>,
    cache: CachePool,
    places: CachePool<Place>,
    /// Light through the tissue behind the wall, if enabled.
    tissue: Option<Transport>,
}

#[pymethods]
impl Radiosity {
    /// Takes a wall at rest, which must not be moved afterwards, and its scene data.
    #[new]
    fn new(py: Python<'_>, rest: Py<Wall>, scene: &Scene) -> PyResult<Self> {
        let wall = rest.try_borrow(py)?;
        scene.data.check_size(&wall)?;
        let (wall, scene): (&Wall, &SceneData) = (&wall, &scene.data);
        let own = rest.clone_ref(py);
        Ok(detached(py, move || {
            let gather_points = GatherPoints::choose(wall);
            let look = PatchAlbedo::mean(wall, scene, &gather_points);
            let mut reflectance = Reflectance::integrate(&scene.material, look.roughness);
            let transport = |tissue| Transport::new(wall, scene, tissue);
            let tissue = scene.tissue.as_ref().map(transport);
            if let Some(tissue) = &tissue {
                reflectance.set_base(|cosine| tissue.transmittance(cosine));
            }
            let rows = gather_points.vertex.iter().map(|_| OnceBox::new()).collect();
            let PatchAlbedo { albedo, per_area, .. } = look;
            let cache = CachePool::new((gather_points.vertex.len(), wall.vertices.len()));
            let places = CachePool::new((gather_points.vertex.len(), 0));
            Radiosity {
                rest: own,
                gather_points,
                albedo,
                per_area,
                reflectance,
                rows,
                cache,
                places,
                tissue,
            }
        }))
    }
}

impl Radiosity {
    /// The wall at rest.
    pub fn rest<'py>(&'py self, py: Python<'py>) -> PyResult<PyRef<'py, Wall>> {
        Ok(self.rest.try_borrow(py)?)
    }

    fn row(&self, rest: &Wall, gather_point: usize) -> &FormFactorRow {
        self.rows[gather_point]
            .get_or_init(|| Box::new(trace_row(rest, &self.gather_points, gather_point)))
    }

    /// Light reflected by a gather point on a wall of this shape, relative to that on a flat wall.
    fn kept(&self, rest: &Wall, gather_point: usize) -> Vec3 {
        let Some(tissue) = &self.tissue else { return [1.0; 3] };
        let kept = tissue.kept(rest, self.gather_points.vertex[gather_point] as usize);
        let [base, gloss] = self.reflectance.mean;
        [0, 1, 2].map(|k| {
            let colored = base * self.albedo[gather_point][k];
            (kept[k] * colored + gloss) / max(colored + gloss, 1e-20)
        })
    }

    /// Fraction of red, green and blue light that a gather point reflects, given the reflectances
    /// of base and gloss for an albedo of 1.
    #[inline(always)]
    fn reflected(&self, gather_point: usize, [base, gloss]: [f32; 2]) -> Vec3 {
        self.albedo[gather_point].map(|albedo| base * albedo + gloss)
    }
}
