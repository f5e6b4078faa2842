//! Light that bounces between the walls, in real time.
//!
//! The wall's radiosity (Goral et al. 1984) on sites of about a tenth of the lumen's width: what a
//! site sees of the others is traced once, at rest; in each frame the LEDs light the sites near the
//! camera, the light bounces between them, and each vertex takes the mean of the sites around it.
//! A pixel has its irradiance from the corners of its face. Gloss bounces as if it were diffuse.
//!
//! Nothing depends on earlier frames: rows are traced when first needed, from the wall at rest.

mod bounce;
mod lamps;
mod lobe;
mod reflectance;
mod rows;
mod sites;

pub use bounce::Irradiance;
use reflectance::Reflectance;
use rows::{Row, trace_row};
use sites::Sites;

use crate::lanes::*;
use crate::scene::{Scene, SceneData};
use crate::wall::Wall;
use pyo3::prelude::*;
use std::sync::OnceLock;

/// Bounced light of a wall: sites, what they reflect and what they see of each other.
#[pyclass(frozen, module = "vrcaps._core")]
pub struct QuickLight {
    rest: Py<Wall>,
    sites: Sites,
    /// Mean base colour of what each site stands for.
    albedo: Vec<Vec3>,
    /// Area of the wall that each site stands for, at rest [m²].
    area: Vec<f32>,
    reflectance: Reflectance,
    rows: Vec<OnceLock<Row>>,
}

#[pymethods]
impl QuickLight {
    /// Takes a wall at rest, which must not be moved afterwards, and what is drawn on it.
    #[new]
    fn new(py: Python<'_>, rest: Py<Wall>, scene: &Scene) -> Self {
        let wall = rest.borrow(py);
        let (wall, scene): (&Wall, &SceneData) = (&wall, &scene.data);
        let (sites, albedo, area, reflectance) = py.detach(|| {
            let sites = Sites::choose(wall);
            let (albedo, area, roughness) = mean_look(wall, scene, &sites);
            (sites, albedo, area, Reflectance::integrate(&scene.material, roughness))
        });
        let rows = sites.vertex.iter().map(|_| OnceLock::new()).collect();
        QuickLight { rest: rest.clone_ref(py), sites, albedo, area, reflectance, rows }
    }

    /// Number of sites.
    #[getter]
    fn num_sites(&self) -> usize {
        self.sites.vertex.len()
    }
}

impl QuickLight {
    /// The wall at rest.
    pub fn rest<'py>(&'py self, py: Python<'py>) -> PyRef<'py, Wall> {
        self.rest.borrow(py)
    }

    fn row(&self, rest: &Wall, site: usize) -> &Row {
        self.rows[site].get_or_init(|| trace_row(rest, &self.sites, site))
    }
}

/// Mean base colour around each site, and mean roughness of the wall; faces count by their size.
fn mean_look(wall: &Wall, scene: &SceneData, sites: &Sites) -> (Vec<Vec3>, Vec<f32>, f32) {
    let mut sums = vec![([0.0f32; 3], 0.0f32); sites.vertex.len()];
    let (mut roughness, mut total) = (0.0f64, 0.0f64);
    for first in (0..wall.bvh.triangles.len()).step_by(LANES) {
        let (albedo, rough, area) = look_of_faces(wall, scene, first);
        for i in 0..LANES.min(wall.bvh.triangles.len() - first) {
            roughness += f64::from(rough[i] * area[i]);
            total += f64::from(area[i]);
            for v in wall.bvh.corners[first + i] {
                let sum = &mut sums[sites.of_vertex[v as usize] as usize];
                sum.0 = add(sum.0, scale(at(&albedo, i), area[i]));
                sum.1 += area[i];
            }
        }
    }
    let mean = |(sum, area): &(Vec3, f32)| scale(*sum, 1.0 / max(*area, 1e-30));
    let area = sums.iter().map(|sum| sum.1 / 3.0).collect();
    (sums.iter().map(mean).collect(), area, (roughness / total.max(1e-30)) as f32)
}

/// Base colour, roughness and area [m²] of a tile's worth of faces, in the order of the hierarchy.
fn look_of_faces(wall: &Wall, scene: &SceneData, first: usize) -> (Lane3, Lane, Lane) {
    let (mut uv, mut footprint, mut area) = ([[0.0; LANES]; 2], [[0.0; LANES]; 2], [0.0; LANES]);
    for (i, triangle) in wall.bvh.triangles[first..].iter().take(LANES).enumerate() {
        let [a, b, c] = triangle.corners;
        let normal = cross(sub(b, a), sub(c, a));
        area[i] = 0.5 * dot(normal, normal).sqrt();
        let [at_a, at_b, at_c] = scene.faces[triangle.face as usize].uv;
        for k in 0..2 {
            uv[k][i] = (at_a[k] + at_b[k] + at_c[k]) / 3.0;
            let low = min(at_a[k], min(at_b[k], at_c[k]));
            let high = max(at_a[k], max(at_b[k], at_c[k]));
            footprint[k][i] = 0.5 * (high - low);
        }
    }
    let Some(texture) = &scene.texture else {
        return (scene.albedo.map(|x| [x; LANES]), [scene.roughness; LANES], area);
    };
    let texels = texture.fetch(&uv, &footprint);
    (texels.albedo, texels.roughness, area)
}
