//! Coverage: the triangles of a wall that are the first hit of camera rays
//! (`vrcaps.metrics.coverage`), for many views in one call.

use crate::pool::on_pool;
use crate::poses::pose_of;
use crate::render::ray_table::{RayTable, TileRays};
use crate::render::tile::intersect;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::MISS;
use numpy::{PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray2};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Visible in some pixel.
const VISIBLE: u8 = 1;
/// Visible at a distance and angle that resolve detail.
const RESOLVED: u8 = 2;

/// Rays of a camera with its pixel density per steradian.
#[derive(Clone, Copy)]
struct Pixels<'a> {
    rays: &'a RayTable,
    /// Density of each pixel, row by row [1/sr].
    per_steradian: &'a [f32],
    /// Minimum density of pixels on an area [1/m²].
    min_density: f32,
    /// Minimum cosine between normal and ray.
    min_cosine: f32,
}

/// Camera position relative to the wall's center and the rows of its rotation to the world.
struct Eye {
    origin: Vec3,
    to_world: [Vec3; 3],
}

impl Eye {
    fn new(wall: &Wall, pose: &[f64]) -> Self {
        let (rotation, place) = pose_of(pose);
        let row = |k: usize| rotation.row(k).as_vec3().to_array();
        Eye { origin: wall.localize(place.to_array()), to_world: [row(0), row(1), row(2)] }
    }
}

/// Marks the triangles visible in a view in `seen`, a byte of flags per triangle.
fn look(wall: &Wall, pixels: &Pixels<'_>, eye: &Eye, seen: &mut [u8]) {
    let columns = pixels.rays.columns();
    for (number, tile) in pixels.rays.tiles.iter().enumerate() {
        look_through_tile(wall, pixels, eye, (tile, number / columns, number % columns), seen);
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn look_through_tile(
    wall: &Wall,
    pixels: &Pixels<'_>,
    eye: &Eye,
    (tile, row, column): (&TileRays, usize, usize),
    seen: &mut [u8],
) {
    let (rays, hits) = intersect(wall, eye.origin, &eye.to_world, tile);
    for i in (0..LANES).filter(|&i| hits.triangle[i] != MISS) {
        let triangle = &wall.bvh.triangles[hits.triangle[i] as usize];
        let [a, b, c] = triangle.corners;
        let normal = normalize(cross(sub(b, a), sub(c, a)));
        let cosine = dot(normal, at(&rays.directions, i)).abs();
        let pixel = (row * TILE + i / TILE) * pixels.rays.width + column * TILE + i % TILE;
        let density = pixels.per_steradian[pixel] * cosine / (hits.distance[i] * hits.distance[i]);
        let resolved = density >= pixels.min_density && cosine >= pixels.min_cosine;
        seen[triangle.face as usize] |= if resolved { VISIBLE | RESOLVED } else { VISIBLE };
    }
}

/// Marks the triangles visible from cameras at poses [n 4 4]: in `seen` [n m], or in `seen` [1 m]
/// for all cameras. Bit 0 is visible, bit 1 resolved. There is one wall for all poses, or one each.
///
/// # Errors
/// If numbers of walls, poses, rows and triangles do not match, or a pose is not finite.
#[pyfunction]
#[pyo3(signature = (walls, rays, pixels_per_steradian, poses, seen, *, min_density, min_cosine))]
#[allow(clippy::too_many_arguments)] // called from Python
pub fn mark_seen(
    py: Python<'_>,
    walls: Vec<PyRef<'_, Wall>>,
    rays: &RayTable,
    pixels_per_steradian: PyReadonlyArray2<'_, f32>,
    poses: PyReadonlyArray3<'_, f64>,
    mut seen: PyReadwriteArray2<'_, u8>,
    min_density: f32,
    min_cosine: f32,
) -> PyResult<()> {
    let (count, rows, columns) = poses.as_array().dim();
    let (num_rows, num_faces) = seen.as_array().dim();
    let fits = (rows, columns) == (4, 4)
        && pixels_per_steradian.as_array().dim() == (rays.height, rays.width)
        && (walls.len() == 1 || walls.len() == count)
        && (num_rows == count || num_rows == 1)
        && walls.iter().all(|wall| wall.faces.len() == num_faces || walls.len() > 1)
        && walls.iter().all(|wall| wall.faces.len() <= num_faces);
    if !fits {
        return Err(PyValueError::new_err(
            "Coverage needs poses [n 4 4], one wall or n, a row of flags for each pose or for all, \
             with a flag for each triangle, and a density for each pixel.",
        ));
    }
    let poses = poses.as_slice()?;
    if !poses.iter().all(|x| x.is_finite()) {
        return Err(PyValueError::new_err("Camera poses must be finite."));
    }
    let per_steradian = pixels_per_steradian.as_slice()?;
    let pixels = Pixels { rays, per_steradian, min_density, min_cosine };
    let walls: Vec<&Wall> = walls.iter().map(|wall| &**wall).collect();
    let view = |number: usize, flags: &mut [u8]| {
        let wall = walls[if walls.len() == 1 { 0 } else { number }];
        look(wall, &pixels, &Eye::new(wall, &poses[16 * number..16 * number + 16]), flags);
    };
    let flags = seen.as_slice_mut()?;
    on_pool(py, || {
        if num_rows == count {
            let each = flags.par_chunks_exact_mut(num_faces.max(1)).with_max_len(1).enumerate();
            each.for_each(|(number, flags)| view(number, flags));
        } else {
            let nothing = || vec![0u8; num_faces];
            let all = (0..count).into_par_iter().fold(nothing, |mut flags, number| {
                view(number, &mut flags);
                flags
            });
            let union = all.reduce(nothing, |mut one, other| {
                one.iter_mut().zip(&other).for_each(|(flag, more)| *flag |= more);
                one
            });
            flags.iter_mut().zip(&union).for_each(|(flag, more)| *flag |= more);
        }
    });
    Ok(())
}
