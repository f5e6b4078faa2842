//! Where points appear in an image, by the rays of its pixels alone: for any lens.

use crate::cpu::on_pool;
use crate::lanes::*;
use crate::rays::RayTable;
use numpy::{
    IntoPyArray, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
    ndarray::Array3,
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Most steps of Newton's method, and the step that is its last [px].
const STEPS: usize = 8;
const SETTLED: f32 = 0.1;

/// How far from every `step`th pixel of every `step`th row, the first in the middle of a square of
/// so many, points appear [rows columns 2], in pixels.
///
/// Between pixels rays are bilinear; beyond the last pixels that see anything they go on as there.
/// NaN where a point is NaN or the pixel sees nothing. `points` [rows columns 3] are in the world,
/// `pose` takes them to the camera.
#[pyfunction]
pub fn flow_by_rays<'py>(
    py: Python<'py>,
    rays: &RayTable,
    points: PyReadonlyArray3<'py, f64>,
    pose: PyReadonlyArray2<'py, f64>,
    step: usize,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let [rows, columns, 3] = points.shape()[..] else {
        return Err(PyValueError::new_err("Points must be of shape (rows, columns, 3)."));
    };
    let last = |count: usize| (count.max(1) - 1) * step + step / 2;
    let fits = last(rows) < rays.height && last(columns) < rays.width;
    if pose.shape() != [4, 4] || rows * columns == 0 || step == 0 || !fits {
        return Err(PyValueError::new_err("Points and pose must fit the camera."));
    }
    let (points, pose) = (points.as_slice()?, pose.as_array());
    let pose = [0, 1, 2].map(|r| [0, 1, 2, 3].map(|c| pose[[r, c]]));
    let mut out = vec![f32::NAN; rows * columns * 2];
    on_pool(py, || {
        let lines = out.par_chunks_mut(columns * 2).zip(points.par_chunks(columns * 3));
        lines.enumerate().for_each(|(row, (line, points))| {
            let mut flow = [0.0; 2]; // neighbours move alike
            for (column, point) in points.chunks_exact(3).enumerate() {
                let towards = pose
                    .map(|r| (r[0] * point[0] + r[1] * point[1] + r[2] * point[2] + r[3]) as f32);
                let from = [column * step + step / 2, row * step + step / 2];
                if let Some(found) = find(rays, from, towards, flow) {
                    flow = found;
                    line[2 * column..2 * column + 2].copy_from_slice(&flow);
                }
            }
        });
    });
    let array = Array3::from_shape_vec((rows, columns, 2), out).expect("one vector a place");
    Ok(array.into_pyarray(py))
}

/// How far from a pixel (column, row) the ray points in a direction, about as far as `guess`.
fn find(rays: &RayTable, pixel: [usize; 2], towards: Vec3, guess: [f32; 2]) -> Option<[f32; 2]> {
    if !towards.iter().all(|x| x.is_finite()) {
        return None;
    }
    rays.direction(pixel[0], pixel[1])?;
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
        // Where nothing is seen rays go on as they do on the way there.
        let half = [at[0] - 0.5 * change[0], at[1] - 0.5 * change[1]];
        let found =
            Cell::of(rays, nearest(rays, at)).or_else(|| Cell::of(rays, nearest(rays, half)));
        cell = found.unwrap_or(cell);
    }
    Some([at[0] - start[0], at[1] - start[1]])
}

/// The pixel before a place, within the image.
fn nearest(rays: &RayTable, at: [f32; 2]) -> [usize; 2] {
    let (right, bottom) = (rays.width as f32 - 1.0, rays.height as f32 - 1.0);
    [clamp(at[0], 0.0, right) as usize, clamp(at[1], 0.0, bottom) as usize]
}

/// Rays between four pixels, which need not be unit vectors: `first + x · right + y · down +
/// x y · twist`, from a corner.
struct Cell {
    corner: [f32; 2],
    first: Vec3,
    right: Vec3,
    down: Vec3,
    twist: Vec3,
}

impl Cell {
    /// The cell right of and below a pixel, or where it has none to those sides left or above.
    #[inline(always)]
    fn of(rays: &RayTable, [x, y]: [usize; 2]) -> Option<Self> {
        if x + 1 < rays.width && y + 1 < rays.height {
            let below = (rays.direction(x, y + 1), rays.direction(x + 1, y + 1));
            let above = (rays.direction(x, y), rays.direction(x + 1, y));
            if let ((Some(first), Some(along)), (Some(below), Some(far))) = (above, below) {
                let (right, down) = (sub(along, first), sub(below, first));
                let twist = sub(sub(add(far, first), along), below);
                return Some(Cell { corner: [x as f32, y as f32], first, right, down, twist });
            }
        }
        Cell::at_the_edge(rays, [x, y])
    }

    /// The same where one of the four pixels sees nothing, or is none.
    fn at_the_edge(rays: &RayTable, [x, y]: [usize; 2]) -> Option<Self> {
        let own = rays.direction(x, y)?;
        let beside =
            |x1: usize, y1: usize| (x1 < rays.width && y1 < rays.height).then_some((x1, y1));
        let pick = |ways: [Option<(usize, usize)>; 2]| {
            ways.into_iter()
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

    /// One step of Newton's method from a place towards where the ray has a direction [px].
    ///
    /// With the ray r and its slopes u and v at the place, `r + a u + b v` is to be parallel to t:
    /// Cramer's rule gives a and b.
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
