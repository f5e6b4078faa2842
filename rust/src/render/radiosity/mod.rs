//! Light that bounces between the walls, in real time.
//!
//! The wall's radiosity (Goral et al. 1984) on sites of about a seventh of the lumen's width: what
//! a site sees of the others is traced once, at rest; in each frame the LEDs light the sites near the
//! camera, the light bounces between them, and each vertex takes the mean of the sites around it.
//! A pixel has its irradiance from the corners of its face. Gloss bounces as if it were diffuse.
//!
//! Nothing depends on earlier frames: rows are traced when first needed, from the wall at rest, and
//! bent in each frame to the wall as it is.

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

use form_factors::{Row, trace_row};
use gather_points::Sites;
use lazy_cache::Rooms;
use patch_albedo::Look;
use reflectance::Reflectance;
pub use solve::Irradiance;
pub use subsurface::Beneath;
use subsurface::Transport;

use crate::render::scene::{Scene, SceneData};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use pyo3::prelude::*;
use std::sync::OnceLock;

/// A colour with a fourth number, so that it is one vector.
type Color = [f32; 4];

/// Bounced light of a wall: sites, what they reflect and what they see of each other.
#[pyclass(frozen, module = "vrcaps._core")]
pub struct Radiosity {
    rest: Py<Wall>,
    sites: Sites,
    /// Mean base colour of what each site stands for.
    albedo: Vec<Vec3>,
    /// One over the area of the wall that each site stands for at rest [1/m²].
    per_area: Vec<f32>,
    reflectance: Reflectance,
    rows: Vec<OnceLock<Row>>,
    room: Rooms,
    /// Light through the tissue behind the wall, if it goes there.
    tissue: Option<Transport>,
}

#[pymethods]
impl Radiosity {
    /// Takes a wall at rest, which must not be moved afterwards, and what is drawn on it.
    #[new]
    fn new(py: Python<'_>, rest: Py<Wall>, scene: &Scene) -> Self {
        let wall = rest.borrow(py);
        let (wall, scene): (&Wall, &SceneData) = (&wall, &scene.data);
        let own = rest.clone_ref(py);
        py.detach(move || {
            let sites = Sites::choose(wall);
            let look = Look::mean(wall, scene, &sites);
            let mut reflectance = Reflectance::integrate(&scene.material, look.roughness);
            let transport = |tissue| Transport::new(wall, scene, tissue);
            let tissue = scene.tissue.as_ref().map(transport);
            if let Some(tissue) = &tissue {
                reflectance.set_base(|cosine| tissue.passes(cosine));
            }
            let rows = sites.vertex.iter().map(|_| OnceLock::new()).collect();
            let Look { albedo, per_area, .. } = look;
            let room = Rooms::new((sites.vertex.len(), wall.vertices.len()));
            Radiosity { rest: own, sites, albedo, per_area, reflectance, rows, room, tissue }
        })
    }
}

impl Radiosity {
    /// The wall at rest.
    pub fn rest<'py>(&'py self, py: Python<'py>) -> PyRef<'py, Wall> {
        self.rest.borrow(py)
    }

    fn row(&self, rest: &Wall, site: usize) -> &Row {
        self.rows[site].get_or_init(|| trace_row(rest, &self.sites, site))
    }

    /// What a site reflects on a wall of such a shape, over what it would on a level one.
    fn kept(&self, rest: &Wall, site: usize) -> Vec3 {
        let Some(tissue) = &self.tissue else { return [1.0; 3] };
        let kept = tissue.kept(rest, self.sites.vertex[site] as usize);
        let [base, gloss] = self.reflectance.mean;
        [0, 1, 2].map(|k| {
            let colored = base * self.albedo[site][k];
            (kept[k] * colored + gloss) / max(colored + gloss, 1e-20)
        })
    }

    /// Share of red, green and blue light that a site reflects, where its base and its gloss
    /// reflect so much for an albedo of 1.
    #[inline(always)]
    fn reflected(&self, site: usize, [base, gloss]: [f32; 2]) -> Vec3 {
        self.albedo[site].map(|albedo| base * albedo + gloss)
    }
}
