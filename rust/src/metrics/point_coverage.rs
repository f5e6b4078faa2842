//! Coverage of an organ by sample points on its wall, weighted by area, for many worlds in one call
//! (`vrcaps.metrics.point_coverage`).

use crate::pool::on_pool;
use crate::poses::pose_of;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::MISS;
use crate::wall::ray::{Pile, cast_in};
use crate::wall::visibility::SHADOW_REACH;
use numpy::{
    IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray1,
    PyReadwriteArray2, ndarray::Array2,
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// In the image and in range, even if occluded.
const FRUSTUM: u8 = 1;
/// In the image and not occluded.
const VISIBLE: u8 = 2;
/// Visible at a distance and angle that resolve detail.
const RESOLVED: u8 = 4;
/// All levels reached.
const ALL: u8 = FRUSTUM | VISIBLE | RESOLVED;
/// Levels of visibility of a point.
const LEVELS: [u8; 3] = [FRUSTUM, VISIBLE, RESOLVED];

/// Points that move with the triangles of a wall.
#[pyclass(module = "vrcaps._core", frozen)]
pub struct WallPoints {
    /// Vertices of each point's triangle.
    corners: Vec<[u32; 3]>,
    /// Barycentric coordinates for the first two vertices.
    weights: Vec<[f32; 2]>,
    /// Weight of each point at the level `frustum`, and at the others.
    fractions: Vec<[f64; 2]>,
    /// Map cell of each point.
    cell: Vec<u32>,
    /// Maximum index of a vertex and of a cell.
    last: (u32, u32),
}

#[pymethods]
impl WallPoints {
    /// Points on triangles of corners [k 3] with barycentric coordinates [k 2], fractions of the
    /// whole that each represents at `frustum` and at other levels [k 2], and map cells [k].
    #[new]
    fn new(
        corners: PyReadonlyArray2<'_, u32>,
        weights: PyReadonlyArray2<'_, f32>,
        fractions: PyReadonlyArray2<'_, f64>,
        cell: PyReadonlyArray1<'_, u32>,
    ) -> PyResult<Self> {
        let count = corners.as_array().nrows();
        let pairs = (count, 2);
        if corners.as_array().ncols() != 3
            || weights.as_array().dim() != pairs
            || fractions.as_array().dim() != pairs
            || cell.as_array().len() != count
        {
            return Err(PyValueError::new_err(
                "Points of a wall need three corners, two weights, two fractions and a cell each.",
            ));
        }
        let (corners, cell) = (corners.as_slice()?, cell.as_slice()?.to_vec());
        let largest = |numbers: &[u32]| numbers.iter().copied().max().unwrap_or(0);
        Ok(WallPoints {
            last: (largest(corners), largest(&cell)),
            corners: corners.as_chunks().0.to_vec(),
            weights: weights.as_slice()?.as_chunks().0.to_vec(),
            fractions: fractions.as_slice()?.as_chunks().0.to_vec(),
            cell,
        })
    }
}

/// Pixels per steradian of a camera by direction, on an octahedron unfolded to a square (Cigolle et
/// al., J. Computer Graphics Techniques 3(2), 2014); 0 where there is no image.
#[pyclass(module = "vrcaps._core", frozen)]
pub struct DirectionTable {
    size: usize,
    density: Vec<f32>,
}

#[pymethods]
impl DirectionTable {
    /// Table from a square array; see `octahedral_directions`.
    #[new]
    fn new(density: PyReadonlyArray2<'_, f32>) -> PyResult<Self> {
        let (rows, columns) = density.as_array().dim();
        if rows != columns || rows == 0 {
            return Err(PyValueError::new_err("A table of directions must be square."));
        }
        Ok(DirectionTable { size: rows, density: density.as_slice()?.to_vec() })
    }
}

impl DirectionTable {
    /// Pixels per steradian in a direction of any length, in the camera frame.
    #[inline(always)]
    fn density(&self, [x, y, z]: Vec3) -> f32 {
        let inverse = 1.0 / (x.abs() + y.abs() + z.abs()).max(f32::MIN_POSITIVE);
        let (mut u, mut v) = (x * inverse, y * inverse);
        if z < 0.0 {
            (u, v) = ((1.0 - v.abs()).copysign(u), (1.0 - u.abs()).copysign(v));
        }
        let index = |w: f32| (((w * 0.5 + 0.5) * self.size as f32) as usize).min(self.size - 1);
        self.density[index(v) * self.size + index(u)]
    }
}

/// Criteria of visibility.
#[derive(Clone, Copy)]
struct Criteria {
    max_depth: f32,
    min_density: f32,
    min_cosine: f32,
}

/// View of one wall by one camera.
struct Look<'a> {
    wall: &'a Wall,
    points: &'a WallPoints,
    table: &'a DirectionTable,
    criteria: Criteria,
    origin: Vec3,
    to_camera: [Vec3; 3],
}

impl Look<'_> {
    /// Marks the points that become visible; adds their weights to `gain` and, at `visible`, to the
    /// map's `cells`.
    fn mark(&self, flags: &mut [u8], cells: &mut [f64], gain: &mut [f64]) {
        let mut pile = Pile::default();
        for (k, way, density) in self.in_image(flags) {
            let flag = &mut flags[k];
            let fresh = self.levels(&mut pile, k, (way, density), *flag) & !*flag;
            if fresh == 0 {
                continue;
            }
            *flag |= fresh;
            let [by_vertex, by_area] = self.points.fractions[k];
            for (level, sum) in LEVELS.iter().zip(gain.iter_mut()) {
                if fresh & level != 0 {
                    *sum += if *level == FRUSTUM { by_vertex } else { by_area };
                }
            }
            if fresh & VISIBLE != 0 {
                cells[self.points.cell[k] as usize] += by_area;
            }
        }
    }

    /// Points in the image that have not reached all levels, the vector to each and the pixel
    /// density there. Separate passes, so that memory accesses of different points overlap.
    fn in_image(&self, flags: &[u8]) -> Vec<(usize, Vec3, f32)> {
        let open = flags.iter().enumerate().filter(|(_, flag)| **flag != ALL);
        let ways: Vec<_> = open.map(|(k, _)| (k, self.way(k))).collect();
        let seen = ways
            .into_iter()
            .map(|(k, way)| (k, way, self.table.density(self.to_camera.map(|row| dot(row, way)))));
        seen.filter(|(.., density)| *density > 0.0).collect()
    }

    /// Vector from the camera to a point.
    #[inline(always)]
    fn way(&self, k: usize) -> Vec3 {
        let [a, b, c] = self.corners(k);
        let [u, v] = self.points.weights[k];
        sub(add(c, add(scale(sub(a, c), u), scale(sub(b, c), v))), self.origin)
    }

    #[inline(always)]
    fn corners(&self, k: usize) -> [Vec3; 3] {
        self.points.corners[k].map(|v| self.wall.vertices[v as usize])
    }

    /// Levels of a point in this view; tests occlusion only for levels not yet in `seen`.
    #[inline(always)]
    fn levels(&self, pile: &mut Pile, k: usize, (offset, density): (Vec3, f32), seen: u8) -> u8 {
        let depth = dot(self.to_camera[2], offset);
        let [a, b, c] = self.corners(k);
        let near = depth > 0.0 && depth <= self.criteria.max_depth;
        let mut found = if near { FRUSTUM } else { 0 };
        let square = dot(offset, offset);
        let distance = square.sqrt();
        let direction = scale(offset, 1.0 / distance.max(f32::MIN_POSITIVE));
        // Normals point into the lumen, against the ray.
        let cosine = -dot(normalize(cross(sub(b, a), sub(c, a))), direction);
        if cosine <= 0.0 {
            return found;
        }
        let criteria = &self.criteria;
        let resolves =
            density * cosine >= criteria.min_density * square && cosine >= criteria.min_cosine;
        let wanted = if resolves { VISIBLE | RESOLVED } else { VISIBLE };
        if wanted & !seen != 0 && self.is_free(pile, direction, distance) {
            found |= wanted;
        }
        found
    }

    #[inline(always)]
    fn is_free(&self, pile: &mut Pile, direction: Vec3, distance: f32) -> bool {
        let ray = (self.origin, direction);
        cast_in::<true>(pile, &self.wall.bvh, ray, distance * SHADOW_REACH, MISS).is_none()
    }
}

/// Marks the points visible to a camera at poses [n 4 4], one in each of `walls`, in `flags`, a
/// byte per point: bit 0 is frustum, bit 1 visible, bit 2 resolved. Adds to `cells` [n c] the
/// points that become visible, and returns their fractions of the whole [n 3].
///
/// # Errors
/// If numbers of walls, points, poses and flags do not match, or a pose is not finite.
#[pyfunction]
#[pyo3(signature = (walls, points, table, poses, flags, cells, *, max_depth, min_density, min_cosine))]
#[allow(clippy::too_many_arguments)] // called from Python
pub fn mark_points<'py>(
    py: Python<'py>,
    walls: Vec<PyRef<'py, Wall>>,
    points: Vec<PyRef<'py, WallPoints>>,
    table: &DirectionTable,
    poses: PyReadonlyArray3<'py, f64>,
    mut flags: Vec<PyReadwriteArray1<'py, u8>>,
    mut cells: PyReadwriteArray2<'py, f64>,
    max_depth: f32,
    min_density: f32,
    min_cosine: f32,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (count, rows, columns) = poses.as_array().dim();
    let num_cells = cells.as_array().ncols();
    let fits = (rows, columns) == (4, 4)
        && [walls.len(), points.len(), flags.len(), cells.as_array().nrows()] == [count; 4]
        && walls.iter().zip(&points).all(|(wall, points)| {
            (points.last.0 as usize) < wall.vertices.len() && (points.last.1 as usize) < num_cells
        })
        && points.iter().zip(&flags).all(|(p, f)| p.corners.len() == f.as_array().len());
    if !fits {
        return Err(PyValueError::new_err(
            "Coverage by points needs a wall, points of it, a pose [4 4], a flag for each point and \
             a row of cells for each view.",
        ));
    }
    let poses = poses.as_slice()?;
    if !poses.iter().all(|x| x.is_finite()) {
        return Err(PyValueError::new_err("Camera poses must be finite."));
    }
    let criteria = Criteria { max_depth, min_density, min_cosine };
    let looks: Vec<Look<'_>> = (0..count)
        .map(|k| {
            let (rotation, place) = pose_of(&poses[16 * k..16 * k + 16]);
            let column = |c: usize| rotation.col(c).as_vec3().to_array();
            Look {
                wall: &walls[k],
                points: &points[k],
                table,
                criteria,
                origin: walls[k].localize(place.to_array()),
                to_camera: [column(0), column(1), column(2)],
            }
        })
        .collect();
    let mut gains = vec![0.0; LEVELS.len() * count];
    let flags = flags.iter_mut().map(|f| f.as_slice_mut()).collect::<Result<Vec<_>, _>>()?;
    let cells = cells.as_slice_mut()?;
    on_pool(py, || {
        let parts = (looks.par_iter(), flags, cells.par_chunks_mut(num_cells.max(1)));
        let gains = gains.par_chunks_mut(LEVELS.len());
        parts
            .into_par_iter()
            .zip(gains)
            .with_max_len(1)
            .for_each(|((look, flags, cells), gain)| look.mark(flags, cells, gain));
    });
    Ok(Array2::from_shape_vec((count, LEVELS.len()), gains)
        .expect("three numbers a view")
        .into_pyarray(py))
}
