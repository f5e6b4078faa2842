//! Image positions of points from the rays of the pixels alone, for any lens.

use crate::pool::on_pool;
use crate::poses::read_pose;
use crate::render::lumen::foreground::FOREGROUND_BUBBLE;
use crate::render::ray_table::RayTable;
use crate::simd::f32x64::*;
use glam::{DMat3, DVec3};
use numpy::{
    IntoPyArray, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
    ndarray::Array3,
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Maximum number of Newton steps, and the length of the last step [px]; the remaining error is
/// about a hundredth of its square.
const STEPS: usize = 8;
const SETTLED: f32 = 0.5;
/// Number of points processed together, in rows that start from the result of the row above.
const RUN: usize = 16;
const ROWS: usize = 8;
/// Maximum gap to the capsule at which a bubble's near side counts as attached to it [m].
const TOUCHING: f32 = 1e-3;

/// Arguments of `flow_by_rays`: label and depth of the foreground [h w], the transform from camera
/// to capsule, half of the capsule's straight length and its radius [m].
pub type GivenFront<'py> =
    (PyReadonlyArray2<'py, u8>, PyReadonlyArray2<'py, f32>, PyReadonlyArray2<'py, f64>, (f32, f32));

/// Objects in front of the wall, some of which may be attached to the capsule.
struct Front<'a> {
    label: &'a [u8],
    depth: &'a [f32],
    to_capsule: Pose,
    capsule: (f32, f32),
}

/// A rigid transform: rotation and position of the origin.
type Pose = (DMat3, DVec3);

impl<'a> Front<'a> {
    fn of(given: &'a GivenFront<'_>, rays: &RayTable) -> PyResult<Self> {
        let (label, depth, pose, capsule) = given;
        let size = [rays.height, rays.width];
        if label.shape() != size || depth.shape() != size || pose.shape() != [4, 4] {
            return Err(PyValueError::new_err("Foreground arrays must fit the camera."));
        }
        let (label, depth) = (label.as_slice()?, depth.as_slice()?);
        let to_capsule = read_pose(pose)?;
        Ok(Front { label, depth, to_capsule, capsule: *capsule })
    }

    /// True if a pixel shows a bubble attached to the capsule, which does not move in the image.
    fn is_on_capsule(&self, pixel: usize, ray: Vec3) -> bool {
        if self.label[pixel] != FOREGROUND_BUBBLE {
            return false;
        }
        let seen = scale(ray, self.depth[pixel] / ray[2]);
        let [x, y, z] = apply(&self.to_capsule, seen);
        let (straight, radius) = self.capsule;
        let along = max(z.abs() - straight, 0.0);
        (x * x + y * y + along * along).sqrt() - radius < TOUCHING
    }
}

#[inline(always)]
fn apply((rotation, origin): &Pose, point: Vec3) -> Vec3 {
    (*rotation * DVec3::from(point.map(f64::from)) + *origin).as_vec3().to_array()
}

/// Arguments of `flow_by_rays`: points in the world [rows columns 3], pose of the camera in it,
/// foreground.
pub type GivenPoints<'py> =
    (PyReadonlyArray3<'py, f32>, PyReadonlyArray2<'py, f64>, Option<GivenFront<'py>>);

/// Points visible in some pixels of a camera, to be located in another image.
pub struct Points<'a> {
    rays: &'a RayTable,
    places: &'a [f32],
    size: (usize, usize),
    to_camera: Pose,
    step: usize,
    front: Option<Front<'a>>,
}

/// Displacement of points from every `step`th pixel of every `step`th row [rows columns 2], in
/// pixels; the first is at the center of a square of `step` pixels.
///
/// Rays are bilinear between pixels and extrapolated beyond the lens's field. NaN where a point is
/// NaN or the pixel outside the field; 0 where a bubble in front is attached to the capsule.
#[pyfunction]
pub fn flow_by_rays<'py>(
    py: Python<'py>,
    rays: &RayTable,
    given: GivenPoints<'_>,
    step: usize,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let points = Points::of(rays, &given, step)?;
    let (rows, columns) = points.size;
    let out = on_pool(py, || points.flow());
    let array = Array3::from_shape_vec((rows, columns, 2), out).expect("one vector per point");
    Ok(array.into_pyarray(py))
}

impl<'a> Points<'a> {
    /// Creates the points of every `step`th pixel.
    pub fn of(rays: &'a RayTable, given: &'a GivenPoints<'_>, step: usize) -> PyResult<Self> {
        let (points, pose, front) = given;
        let [rows, columns, 3] = points.shape()[..] else {
            return Err(PyValueError::new_err("Points must be of shape (rows, columns, 3)."));
        };
        let last = |count: usize| (count.max(1) - 1) * step + step / 2;
        let fits = last(rows) < rays.height && last(columns) < rays.width;
        if pose.shape() != [4, 4] || rows * columns == 0 || step == 0 || !fits {
            return Err(PyValueError::new_err("Points and pose must fit the camera."));
        }
        let front = front.as_ref().map(|given| Front::of(given, rays)).transpose()?;
        let (rotation, origin) = read_pose(pose)?;
        let back = rotation.transpose();
        let (places, to_camera) = (points.as_slice()?, (back, -(back * origin)));
        Ok(Points { rays, places, size: (rows, columns), to_camera, step, front })
    }

    /// Numbers of rows and columns.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Displacement of each point from its pixel [rows columns 2], in pixels.
    pub fn flow(&self) -> Vec<f32> {
        let (rows, columns) = self.size;
        let mut out = vec![f32::NAN; rows * columns * 2];
        out.par_chunks_mut(ROWS * columns * 2).enumerate().for_each(|(group, lines)| {
            let mut guess = vec![[0.0; RUN]; 2 * columns.div_ceil(RUN)];
            for (k, line) in lines.chunks_exact_mut(columns * 2).enumerate() {
                flow_line(self, group * ROWS + k, &mut guess, line);
            }
        });
        out
    }

    /// Pixel (column, row) of an array index.
    #[inline(always)]
    fn pixel(&self, column: usize, row: usize) -> [usize; 2] {
        [column, row].map(|k| k * self.step + self.step / 2)
    }

    /// Direction from the camera to the point of a pixel.
    #[inline(always)]
    fn towards(&self, column: usize, row: usize) -> Vec3 {
        let place = &self.places[3 * (row * self.size.1 + column)..][..3];
        apply(&self.to_camera, [place[0], place[1], place[2]])
    }
}

/// Directions to some points, their estimated positions (columns and rows), and the ones still
/// active among pixels inside the field.
struct Search {
    towards: [[f32; RUN]; 3],
    at: [[f32; RUN]; 2],
    is_open: [bool; RUN],
}

/// Fills a row of vectors; `guess` has those of the row above, by runs of columns and rows.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn flow_line(points: &Points<'_>, row: usize, guess: &mut [[f32; RUN]], line: &mut [f32]) {
    let (rays, columns) = (points.rays, points.size.1);
    for (run, guess) in guess.chunks_exact_mut(2).enumerate() {
        let first = run * RUN;
        let count = (columns - first).min(RUN);
        let mut search =
            Search { towards: [[0.0; RUN]; 3], at: [[0.0; RUN]; 2], is_open: [false; RUN] };
        for i in 0..count {
            let (towards, pixel) = (points.towards(first + i, row), points.pixel(first + i, row));
            search.is_open[i] = towards.iter().all(|x| x.is_finite());
            for k in 0..3 {
                search.towards[k][i] = towards[k];
            }
            for k in 0..2 {
                search.at[k][i] = pixel[k] as f32 + guess[k][i];
            }
        }
        let sought = search.is_open;
        search.settle(rays);
        for i in (0..count).filter(|&i| sought[i]) {
            let [x, y] = points.pixel(first + i, row);
            let Some(ray) = rays.direction(x, y) else { continue };
            let front = points.front.as_ref();
            let place = &mut line[2 * (first + i)..][..2];
            if front.is_some_and(|front| front.is_on_capsule(y * rays.width + x, ray)) {
                place.fill(0.0);
                continue;
            }
            let found = if search.is_open[i] {
                Some([search.at[0][i] - x as f32, search.at[1][i] - y as f32])
            } else {
                let towards = at(&search.towards, i);
                find(rays, [x, y], towards, [guess[0][i], guess[1][i]])
            };
            if let Some(found) = found {
                place.copy_from_slice(&found);
                (guess[0][i], guess[1][i]) = (found[0], found[1]);
            }
        }
    }
}

impl Search {
    /// Runs Newton's method for all points at once; deactivates those outside the lens's field.
    #[inline(always)]
    fn settle(&mut self, rays: &RayTable) {
        let (width, height) = (rays.width, rays.height);
        if width < 2 || height < 2 {
            self.is_open = [false; RUN];
        }
        for _ in 0..STEPS {
            if !self.is_open.contains(&true) {
                return;
            }
            let mut corners = [[[0.0f32; RUN]; 3]; 4];
            let mut inside = [[0.0f32; RUN]; 2];
            for i in 0..RUN {
                if !self.is_open[i] {
                    continue;
                }
                let x = clamp(self.at[0][i], 0.0, width as f32 - 2.0) as usize;
                let y = clamp(self.at[1][i], 0.0, height as f32 - 2.0) as usize;
                (inside[0][i], inside[1][i]) = (self.at[0][i] - x as f32, self.at[1][i] - y as f32);
                let (above, below) =
                    (&rays.pixels[y * width + x..][..2], &rays.pixels[(y + 1) * width + x..][..2]);
                let four = [above[0], above[1], below[0], below[1]];
                for (corner, pixel) in corners.iter_mut().zip(four) {
                    self.is_open[i] &= pixel[3] > 0.0;
                    for k in 0..3 {
                        corner[k][i] = pixel[k];
                    }
                }
            }
            if self.step(&corners, &inside) {
                return;
            }
        }
    }

    /// One step of all points, see `Cell::step`; true if all steps were short.
    #[inline(always)]
    fn step(&mut self, corners: &[Lanes3; 4], inside: &[[f32; RUN]; 2]) -> bool {
        let mut farthest = [0.0f32; RUN];
        for i in 0..RUN {
            let four = [0, 1, 2, 3].map(|c| at(&corners[c], i));
            let change = Cell::between([0.0; 2], four)
                .step([inside[0][i], inside[1][i]], at(&self.towards, i));
            let change = change.map(|c| if self.is_open[i] { c } else { 0.0 });
            self.at[0][i] += change[0];
            self.at[1][i] += change[1];
            farthest[i] = max(change[0].abs(), change[1].abs());
        }
        farthest.iter().all(|&change| change < SETTLED)
    }
}

type Lanes3 = [[f32; RUN]; 3];

/// Displacement from a pixel (column, row) to the ray in a direction, near `guess`.
fn find(rays: &RayTable, pixel: [usize; 2], towards: Vec3, guess: [f32; 2]) -> Option<[f32; 2]> {
    let start = pixel.map(|x| x as f32);
    let mut at = [start[0] + guess[0], start[1] + guess[1]];
    let mut cell = match Cell::of(rays, nearest(rays, at)) {
        Some(cell) => cell,
        None => {
            at = start;
            Cell::of(rays, pixel)?
        }
    };
    for _ in 0..STEPS {
        let change = cell.step(at, towards);
        at = [at[0] + change[0], at[1] + change[1]];
        if max(change[0].abs(), change[1].abs()) < SETTLED {
            break;
        }
        // Outside the field, rays are extrapolated from a position half-way back.
        let half = [at[0] - 0.5 * change[0], at[1] - 0.5 * change[1]];
        let found =
            Cell::of(rays, nearest(rays, at)).or_else(|| Cell::of(rays, nearest(rays, half)));
        cell = found.unwrap_or(cell);
    }
    Some([at[0] - start[0], at[1] - start[1]])
}

/// Pixel before a position, within the image.
fn nearest(rays: &RayTable, at: [f32; 2]) -> [usize; 2] {
    let (right, bottom) = (rays.width as f32 - 1.0, rays.height as f32 - 1.0);
    [clamp(at[0], 0.0, right) as usize, clamp(at[1], 0.0, bottom) as usize]
}

/// Rays between four pixels, not necessarily unit vectors: `first + x · right + y · down + x y ·
/// twist`, from a corner.
struct Cell {
    corner: [f32; 2],
    first: Vec3,
    right: Vec3,
    down: Vec3,
    twist: Vec3,
}

impl Cell {
    /// Cell to the right of and below a pixel, or to the left or above at the edge of the field.
    #[inline(always)]
    fn of(rays: &RayTable, [x, y]: [usize; 2]) -> Option<Self> {
        if x + 1 < rays.width && y + 1 < rays.height {
            let below = (rays.direction(x, y + 1), rays.direction(x + 1, y + 1));
            let above = (rays.direction(x, y), rays.direction(x + 1, y));
            if let ((Some(first), Some(along)), (Some(below), Some(far))) = (above, below) {
                return Some(Cell::between([x as f32, y as f32], [first, along, below, far]));
            }
        }
        Cell::at_the_edge(rays, [x, y])
    }

    /// Cell between a pixel and those to the right of it, below it, and both.
    #[inline(always)]
    fn between(corner: [f32; 2], [first, along, below, far]: [Vec3; 4]) -> Self {
        let (right, down) = (sub(along, first), sub(below, first));
        let twist = sub(sub(add(far, first), along), below);
        Cell { corner, first, right, down, twist }
    }

    /// Cell in which one of the four pixels is outside the field or the image.
    fn at_the_edge(rays: &RayTable, [x, y]: [usize; 2]) -> Option<Self> {
        let own = rays.direction(x, y)?;
        let beside =
            |x1: usize, y1: usize| (x1 < rays.width && y1 < rays.height).then_some((x1, y1));
        let pick = |found: [Option<(usize, usize)>; 2]| {
            found
                .into_iter()
                .flatten()
                .find_map(|(x1, y1)| Some(((x1, y1), rays.direction(x1, y1)?)))
        };
        let ((x1, _), along) = pick([beside(x + 1, y), x.checked_sub(1).map(|x| (x, y))])?;
        let ((_, y1), below) = pick([beside(x, y + 1), y.checked_sub(1).map(|y| (x, y))])?;
        let (side, fall) = (x1 as f32 - x as f32, y1 as f32 - y as f32);
        let (right, down) = (scale(sub(along, own), side), scale(sub(below, own), fall));
        let twist = rays
            .direction(x1, y1)
            .map_or([0.0; 3], |far| scale(sub(sub(add(far, own), along), below), side * fall));
        Some(Cell { corner: [x as f32, y as f32], first: own, right, down, twist })
    }

    /// One Newton step from a position towards that where the ray has a direction [px].
    ///
    /// With the ray r and its slopes u and v at the position, `r + a u + b v` is to be parallel to
    /// t: Cramer's rule gives a and b.
    #[inline(always)]
    fn step(&self, at: [f32; 2], towards: Vec3) -> [f32; 2] {
        let [x, y] = [at[0] - self.corner[0], at[1] - self.corner[1]];
        let right = add(self.right, scale(self.twist, y));
        let down = add(self.down, scale(self.twist, x));
        let ray = add(add(self.first, scale(self.right, x)), scale(down, y));
        let (of_right, of_down) = (cross(down, towards), cross(towards, right));
        let inverse = -1.0 / dot(right, of_right);
        [dot(ray, of_right) * inverse, dot(ray, of_down) * inverse]
    }
}
