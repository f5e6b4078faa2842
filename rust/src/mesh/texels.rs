//! Texels covered by triangles (`vrcaps.mesh.rasterize`).

use crate::pool::on_pool;
use numpy::ndarray::{Array2, ArrayView2, Axis};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray3};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// Number of rows in a chunk.
const ROWS: i64 = 64;
/// Maximum coordinate of a corner, and maximum margin [texels].
const FARTHEST: f64 = 1e6;
/// Minimum length of a side in the computation of distances [texels].
const SHORTEST: f64 = 1e-12;
/// Texel without a face: depth and index of its face.
const UNCOVERED: (f32, i32) = (f32::NEG_INFINITY, -1);

type Point = [f64; 2];

/// Triangle in texel coordinates; texel centers are integers.
struct Face {
    number: i32,
    corners: [Point; 3],
    /// Length of the side opposite each corner.
    sides: [f64; 3],
    doubled_area: f64,
    columns: RangeInclusive<i64>,
    rows: RangeInclusive<i64>,
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn from_to(a: Point, b: Point) -> Point {
    [b[0] - a[0], b[1] - a[1]]
}

impl Face {
    /// Face from its corners; `None` if it has no area.
    fn new(number: usize, corners: ArrayView2<'_, f64>, margin: f64) -> Option<Self> {
        let [a, b, c] = [0, 1, 2].map(|k| [corners[[k, 0]], corners[[k, 1]]]);
        let doubled_area = cross(from_to(a, b), from_to(a, c));
        let side = |a, b| {
            let [x, y] = from_to(a, b);
            x.hypot(y).max(SHORTEST)
        };
        let range = |axis: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]) - margin;
            let high = a[axis].max(b[axis]).max(c[axis]) + margin;
            low.floor() as i64..=high.ceil() as i64
        };
        (doubled_area != 0.0).then(|| Face {
            number: number as i32,
            corners: [a, b, c],
            sides: [side(b, c), side(c, a), side(a, b)],
            doubled_area,
            columns: range(0),
            rows: range(1),
        })
    }

    /// Twice the signed areas between a texel and each side.
    fn areas(&self, column: i64, row: i64) -> [f64; 3] {
        let texel = [column as f64, row as f64];
        let [a, b, c] = self.corners.map(|corner| from_to(texel, corner));
        [cross(b, c), cross(c, a), cross(a, b)]
    }

    /// Depth of a texel [texels]: zero inside, minus the distance from a side beyond it; `None`
    /// from the margin on.
    fn depth(&self, column: i64, row: i64, margin: f64) -> Option<f32> {
        let turn = self.doubled_area.signum();
        let areas = self.areas(column, row).map(|area| area * turn);
        if areas.iter().all(|area| *area > 0.0) {
            return Some(0.0);
        }
        let beyond = areas.iter().zip(self.sides).filter(|(area, _)| **area < 0.0);
        let depth = beyond.map(|(area, side)| area / side).fold(0.0, f64::min);
        (depth > -margin).then_some(depth as f32)
    }

    /// Barycentric coordinates of a texel; beyond a side, those of the nearest side.
    fn weights(&self, column: i64, row: i64) -> [f64; 3] {
        let shares = self.areas(column, row).map(|area| (area / self.doubled_area).max(0.0));
        let total = shares[0] + shares[1] + shares[2];
        shares.map(|share| f64::from((share / total) as f32))
    }
}

/// Texels that faces cover.
#[derive(Default)]
struct Texels {
    columns: Vec<i32>,
    rows: Vec<i32>,
    faces: Vec<i32>,
    weights: Vec<f64>,
}

impl Texels {
    /// Texels covered in a range of rows by the faces there; row by row, each once.
    fn of(faces: &[&Face], rows: RangeInclusive<i64>, margin: f64) -> Self {
        let mut found = Self::default();
        let first = faces.iter().map(|face| *face.columns.start()).min().unwrap_or(0);
        let last = faces.iter().map(|face| *face.columns.end()).max().unwrap_or(-1);
        let mut texels = vec![UNCOVERED; (last + 1 - first) as usize];
        for row in rows {
            texels.fill(UNCOVERED);
            for (place, face) in faces.iter().enumerate().filter(|(_, f)| f.rows.contains(&row)) {
                let start = (face.columns.start() - first) as usize;
                for (texel, column) in texels[start..].iter_mut().zip(face.columns.clone()) {
                    // A texel inside several faces belongs to the first of them.
                    if texel.0 >= 0.0 {
                        continue;
                    }
                    let depth = face.depth(column, row, margin);
                    if let Some(depth) = depth.filter(|depth| *depth > texel.0) {
                        *texel = (depth, place as i32);
                    }
                }
            }
            for (texel, column) in texels.iter().zip(first..).filter(|(texel, _)| texel.1 >= 0) {
                found.add(faces[texel.1 as usize], column, row);
            }
        }
        found
    }

    fn add(&mut self, face: &Face, column: i64, row: i64) {
        self.columns.push(column as i32);
        self.rows.push(row as i32);
        self.faces.push(face.number);
        self.weights.extend(face.weights(column, row));
    }

    fn joined(parts: &[Self]) -> Self {
        fn all<T: Clone>(parts: &[Texels], column: impl Fn(&Texels) -> &[T]) -> Vec<T> {
            parts.iter().map(column).collect::<Vec<_>>().concat()
        }
        Self {
            columns: all(parts, |part| &part.columns),
            rows: all(parts, |part| &part.rows),
            faces: all(parts, |part| &part.faces),
            weights: all(parts, |part| &part.weights),
        }
    }
}

/// All texels that faces cover, row by row.
fn covered(faces: &[Face], margin: f64) -> Texels {
    let block = |row: i64| row.div_euclid(ROWS);
    let first = faces.iter().map(|face| block(*face.rows.start())).min().unwrap_or(0);
    let last = faces.iter().map(|face| block(*face.rows.end())).max().unwrap_or(-1);
    let mut blocks: Vec<Vec<&Face>> = (first..=last).map(|_| Vec::new()).collect();
    for face in faces {
        for number in block(*face.rows.start())..=block(*face.rows.end()) {
            blocks[(number - first) as usize].push(face);
        }
    }
    let parts: Vec<Texels> = blocks
        .par_iter()
        .enumerate()
        .map(|(place, faces)| {
            let start = (first + place as i64) * ROWS;
            Texels::of(faces, start..=start + ROWS - 1, margin)
        })
        .collect();
    Texels::joined(&parts)
}

/// Result of `covered_texels` for Python.
type Found<'py> = (
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray2<f64>>,
);

/// Column, row, face and barycentric coordinates [n 3] of the texels whose centers lie in a face or
/// within `margin` texels of one; `corners` [m 3 2] are each face's columns and rows.
///
/// # Errors
/// If corners are not of triangles, or they or the margin exceed a million texels.
#[pyfunction]
pub fn covered_texels<'py>(
    py: Python<'py>,
    corners: PyReadonlyArray3<'py, f64>,
    margin: f64,
) -> PyResult<Found<'py>> {
    let corners = corners.as_array();
    if corners.dim().1 != 3 || corners.dim().2 != 2 || i32::try_from(corners.dim().0).is_err() {
        return Err(PyValueError::new_err("Corners of triangles must be [m 3 2]."));
    }
    let is_near = corners.iter().all(|value| value.abs() <= FARTHEST);
    if !is_near || !(0.0..=FARTHEST).contains(&margin) {
        return Err(PyValueError::new_err(
            "Corners and margin must be numbers of at most a million texels.",
        ));
    }
    let found = on_pool(py, || {
        let faces = corners.axis_iter(Axis(0)).enumerate();
        let faces: Vec<_> = faces.filter_map(|(k, face)| Face::new(k, face, margin)).collect();
        covered(&faces, margin)
    });
    let weights =
        Array2::from_shape_vec((found.faces.len(), 3), found.weights).expect("three each");
    Ok((
        found.columns.into_pyarray(py),
        found.rows.into_pyarray(py),
        found.faces.into_pyarray(py),
        weights.into_pyarray(py),
    ))
}
