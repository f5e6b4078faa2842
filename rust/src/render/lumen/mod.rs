//! Optics of the lumen contents: bubbles, particles and pools of liquid in front of the wall.

pub mod bubble;
pub mod foreground;
pub mod intersect;
pub mod lens;
pub mod liquid;
pub mod mirror_images;
pub mod particle_surfaces;
pub mod path_segment;
pub mod refraction;
pub mod rim;

use crate::lumen::spheres::{BUBBLE, SphereArrays, Spheres};
use crate::pool::detached;
use crate::simd::f32x64::Vec3;
use crate::wall::Wall;
use bubble::Film;
use liquid::{Optics, Pools};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2, ndarray::ArrayView1};
use pyo3::{exceptions::PyValueError, prelude::*};

#[derive(FromPyObject)]
struct FilmParameters {
    ior: f32,
    border: f32,
    gleam: f32,
    stain: Vec3,
    meniscus: f32,
    shade: f32,
    ripple: f32,
    roughness: f32,
}

#[derive(FromPyObject)]
struct LiquidParameters {
    ior: f32,
    absorption: Vec3,
    scattering: Vec3,
    roughness: f32,
}

/// Pools: levels [p] in the outside world [m], and the pool of each vertex [n] (0 for none, 1 for
/// the first).
#[derive(FromPyObject)]
struct PoolArrays<'py> {
    levels: PyReadonlyArray1<'py, f64>,
    of_vertex: PyReadonlyArray1<'py, u16>,
}

/// Contents of a lumen at one instant, ready for rendering.
#[pyclass(module = "vrcaps._core")]
pub struct Contents {
    /// Bubbles.
    pub bubbles: Spheres,
    /// Opaque particles.
    pub chyme: Spheres,
    /// Shells of the bubbles.
    pub film: Film,
    /// Pools and their liquid.
    pub pools: Option<(Pools, Optics)>,
    /// Class of particles.
    pub label: u8,
}

#[pymethods]
impl Contents {
    /// Creates contents from spheres in the wall's outside world, and pools.
    #[new]
    fn new(
        wall: &Wall,
        spheres: SphereArrays<'_>,
        film: FilmParameters,
        pools: Option<(PoolArrays<'_>, LiquidParameters)>,
        label: u8,
    ) -> PyResult<Self> {
        let kind = spheres.kind.as_array().to_vec();
        let (bubbles, chyme) = spheres
            .read(wall)?
            .into_iter()
            .partition(|sphere| kind[sphere.number as usize] == BUBBLE);
        let pools = match pools {
            Some((pools, liquid)) => Some((pooled(wall, &pools)?, optics(&liquid))),
            None => None,
        };
        let film = Film {
            ior: film.ior,
            border: film.border,
            gleam: film.gleam,
            stain: film.stain,
            meniscus: film.meniscus,
            shade: film.shade,
            ripple: film.ripple,
            roughness: film.roughness,
        };
        let (bubbles, chyme) = (Spheres::build(bubbles), Spheres::bound(chyme));
        Ok(Contents { bubbles, chyme, film, pools, label })
    }

    /// Moves all spheres to new centers [n 3] in the wall's outside world.
    fn move_to(&mut self, wall: &Wall, centers: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let rows = centers.as_array();
        let count = self.bubbles.all.len() + self.chyme.all.len();
        if rows.dim() != (count, 3) || !rows.iter().all(|x| x.is_finite()) {
            return Err(PyValueError::new_err("Spheres need one finite center each."));
        }
        let place = |k: usize| wall.localize([0, 1, 2].map(|axis| rows[[k, axis]]));
        self.bubbles.move_to(place);
        self.chyme.move_to(place);
        Ok(())
    }

    /// `true` where no particle occludes the segment from `origin` to a point [n].
    fn free<'py>(
        &self,
        py: Python<'py>,
        wall: &Wall,
        origin: [f64; 3],
        points: PyReadonlyArray2<'_, f64>,
    ) -> Bound<'py, PyArray1<bool>> {
        let rows = points.as_array();
        let points: Vec<Vec3> =
            rows.outer_iter().map(|r| wall.localize([r[0], r[1], r[2]])).collect();
        let (origin, extent) = (wall.localize(origin), wall.extent);
        detached(py, || self.chyme.free(origin, &points, extent)).into_pyarray(py)
    }

    /// `true` where neither wall nor particles occlude the segment from each of `starts` [n 3] to
    /// its point [n].
    fn segments_unoccluded<'py>(
        &self,
        py: Python<'py>,
        wall: &Wall,
        starts: PyReadonlyArray2<'_, f64>,
        points: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let (starts, points) = (starts.as_array(), points.as_array());
        if starts.dim() != points.dim() || starts.ncols() != 3 {
            return Err(PyValueError::new_err("Segments need as many starts as points."));
        }
        let place = |row: ArrayView1<'_, f64>| wall.localize([row[0], row[1], row[2]]);
        let segments: Vec<[Vec3; 2]> = starts
            .outer_iter()
            .zip(points.outer_iter())
            .map(|(a, b)| [place(a), place(b)])
            .collect();
        let find = || particle_surfaces::segments_unoccluded(&self.chyme, wall, &segments);
        Ok(detached(py, find).into_pyarray(py))
    }
}

fn optics(liquid: &LiquidParameters) -> Optics {
    Optics {
        ior: liquid.ior,
        absorption: liquid.absorption,
        scattering: liquid.scattering,
        roughness: liquid.roughness,
    }
}

fn pooled(wall: &Wall, given: &PoolArrays<'_>) -> PyResult<Pools> {
    let of_vertex = given.of_vertex.as_array().to_vec();
    let levels: Vec<f32> =
        given.levels.as_array().iter().map(|z| (z - wall.center[2]) as f32).collect();
    let known = |&pool: &u16| usize::from(pool) <= levels.len();
    if of_vertex.len() != wall.vertices.len() || !of_vertex.iter().all(known) {
        return Err(PyValueError::new_err("Pools need a pool index for each vertex."));
    }
    Ok(Pools { levels, of_vertex })
}
