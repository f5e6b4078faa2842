//! Intersecting triangles of a mesh (`vrcaps.mesh.self_intersection`).

use crate::pool::map;
use glam::{DVec3, Vec3A};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2, PyReadonlyArray3};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Minimum number of triangles for a thread.
const PART: usize = 16_384;

struct Triangle {
    corners: [DVec3; 3],
    /// Unit normal.
    normal: DVec3,
    /// Vertices at the corners; those at one position have the same index.
    vertices: [i64; 3],
}

impl Triangle {
    /// A triangle; None if it has no area.
    fn new(corners: [DVec3; 3], vertices: [i64; 3]) -> Option<Self> {
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).try_normalize()?;
        Some(Triangle { corners, normal, vertices })
    }

    /// Side of this triangle's plane for each point: −1, 0 or 1. Heights within the tolerance [m]
    /// are zero.
    fn sides(&self, points: &[DVec3; 3], tolerance: f64) -> [i8; 3] {
        points.map(|point| {
            let height = (point - self.corners[0]).dot(self.normal);
            i8::from(height > tolerance) - i8::from(height < -tolerance)
        })
    }

    fn num_shared(&self, other: &Self) -> usize {
        self.vertices.iter().filter(|&vertex| other.vertices.contains(vertex)).count()
    }

    /// Returns whether an edge of this triangle passes through another. `sides` locates the corners
    /// of this triangle relative to the plane of the other.
    ///
    /// An edge p q with its ends on both sides of the plane of a b c passes through if the volumes
    /// of p q a b, p q b c and p q c a have one sign.
    fn has_edge_through(&self, other: &Self, sides: [i8; 3]) -> bool {
        (0..3).filter(|&k| sides[k] * sides[(k + 2) % 3] < 0).any(|k| {
            let start = self.corners[k];
            let edge = self.corners[(k + 2) % 3] - start;
            let [a, b, c] = other.corners.map(|corner| corner - start);
            let volumes = [(a, b), (b, c), (c, a)].map(|(u, v)| edge.dot(u.cross(v)));
            volumes.iter().all(|&v| v >= 0.0) || volumes.iter().all(|&v| v <= 0.0)
        })
    }

    /// Returns whether this triangle shares an area with another in its plane: no edge separates
    /// them.
    fn overlaps(&self, other: &Self, tolerance: f64) -> bool {
        ![self, other].iter().any(|triangle| {
            (0..3).any(|k| {
                let edge = triangle.corners[k] - triangle.corners[(k + 2) % 3];
                let across = edge.cross(self.normal);
                let across = across / across.length().max(tolerance);
                let [(low, high), (other_low, other_high)] =
                    [self, other].map(|one| extent(one.corners.map(|point| point.dot(across))));
                high <= other_low + tolerance || other_high <= low + tolerance
            })
        })
    }

    /// Returns whether this triangle intersects another. Triangles with a common edge do not; nor
    /// does one that lies on one side of the other's plane, apart from a common vertex.
    fn intersects(&self, other: &Self, tolerance: f64) -> bool {
        let shared = self.num_shared(other);
        if shared >= 2 {
            return false;
        }
        let is_beside = |sides: [i8; 3]| {
            sides.iter().map(|&side| i32::from(side)).sum::<i32>().unsigned_abs() as usize
                >= 3 - shared
        };
        let sides = other.sides(&self.corners, tolerance);
        if is_beside(sides) {
            return false;
        }
        let other_sides = self.sides(&other.corners, tolerance);
        if is_beside(other_sides) {
            return false;
        }
        if sides == [0; 3] && other_sides == [0; 3] {
            return self.overlaps(other, tolerance);
        }
        self.has_edge_through(other, sides) || other.has_edge_through(self, other_sides)
    }
}

fn extent(values: [f64; 3]) -> (f64, f64) {
    let [a, b, c] = values;
    (a.min(b).min(c), a.max(b).max(c))
}

/// Box in single precision around a triangle, rounded outwards.
fn bounds(corners: &[DVec3; 3]) -> Aabb {
    let [a, b, c] = *corners;
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    let round = |point: DVec3, outwards: fn(f32) -> f32| {
        Vec3A::from(point.to_array().map(|value| outwards(value as f32)))
    };
    Aabb::new(round(low, f32::next_down), round(high, f32::next_up))
}

/// Triangles with area, the hierarchy of their boxes, and their indices in the mesh.
struct Mesh {
    triangles: Vec<Triangle>,
    boxes: Vec<Aabb>,
    hierarchy: Bvh2,
    faces: Vec<i64>,
    tolerance: f64,
}

impl Mesh {
    /// Later triangles that intersect the triangle `index`.
    fn intersecting(&self, index: usize) -> Vec<usize> {
        let mut found = Vec::new();
        let one = &self.triangles[index];
        self.hierarchy.aabb_traverse(self.boxes[index], |hierarchy, node| {
            // A leaf has one triangle.
            let leaf = hierarchy.nodes[node as usize].first_index as usize;
            let other = hierarchy.primitive_indices[leaf] as usize;
            if other > index && one.intersects(&self.triangles[other], self.tolerance) {
                found.push(other);
            }
            true
        });
        found.sort_unstable();
        found
    }
}

/// Pairs of intersecting triangles, in order, the lower index first.
///
/// `corners` (n, 3, 3) are their positions, `vertices` (n, 3) the indices of their vertices, equal
/// for vertices at one position. Heights over a plane up to `tolerance` are zero. Triangles without
/// area are ignored.
#[pyfunction]
pub fn intersecting_triangles<'py>(
    py: Python<'py>,
    corners: PyReadonlyArray3<'py, f64>,
    vertices: PyReadonlyArray2<'py, i64>,
    tolerance: f64,
) -> PyResult<Bound<'py, PyArray2<i64>>> {
    let (corners, vertices) = (corners.as_array(), vertices.as_array());
    if corners.dim() != (vertices.nrows(), 3, 3) || vertices.ncols() != 3 {
        return Err(PyValueError::new_err("expected corners (n, 3, 3) and vertices (n, 3)"));
    }
    let (mut triangles, mut faces) = (Vec::new(), Vec::new());
    for face in 0..vertices.nrows() {
        let at =
            |k| DVec3::new(corners[[face, k, 0]], corners[[face, k, 1]], corners[[face, k, 2]]);
        let indices = [0, 1, 2].map(|k| vertices[[face, k]]);
        if let Some(triangle) = Triangle::new([0, 1, 2].map(at), indices) {
            triangles.push(triangle);
            faces.push(face as i64);
        }
    }
    let boxes: Vec<Aabb> = triangles.iter().map(|triangle| bounds(&triangle.corners)).collect();
    let indices = (0..triangles.len() as u32).collect();
    let (width, sort) = (PlocSearchDistance::Minimum, SortPrecision::U64);
    let hierarchy = py.detach(|| PlocBuilder::new().build(width, &boxes, indices, sort, 0));
    let mesh = Mesh { triangles, boxes, hierarchy, faces, tolerance };
    let indices: Vec<usize> = (0..mesh.triangles.len()).collect();
    let found = map(py, &indices, PART, |&index| mesh.intersecting(index));
    let pairs: Vec<i64> = found
        .iter()
        .enumerate()
        .flat_map(|(one, others)| others.iter().map(move |&other| (one, other)))
        .flat_map(|(one, other)| [mesh.faces[one], mesh.faces[other]])
        .collect();
    let pairs = Array2::from_shape_vec((pairs.len() / 2, 2), pairs).expect("two of each pair");
    Ok(pairs.into_pyarray(py))
}
