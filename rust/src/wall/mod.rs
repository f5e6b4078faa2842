//! Moving triangle mesh with its bounding-volume hierarchy: ray casting, nearest points,
//! visibility.

pub mod bundle;
pub mod bvh;
pub mod disc_visibility;
pub mod distances;
pub mod packet;
mod partial_refit;
pub mod query;
pub mod ray;
mod sides;
pub mod visibility;

use crate::pool::{detached, install, map};
use crate::simd::f32x64::{Vec3, add, cross, normalize, sub};
use crate::wall::bvh::{Bvh, DEEPEST, vertex};
use glam::Vec3A;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2, ndarray::Array2};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Number of vertices whose normals are normalized together.
const EIGHT: usize = 8;
/// Minimum number of points or rays per thread.
const PART: usize = 64;

/// Nearest point and its face for each query point, as returned to Python.
type PlaceAndFace<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<i64>>);

/// Distance and face of each ray, as returned to Python.
type DistanceAndFace<'py> = (Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<i64>>);

/// A triangle surface with its bounding-volume hierarchy; normals point into the lumen.
///
/// Positions are relative to the center of the mesh, so that single precision does not depend on
/// the position of the mesh in the world.
#[pyclass(module = "vrcaps._core")]
#[derive(Clone)]
pub struct Wall {
    /// Center of the mesh's bounds at construction; subtracted from every position [m].
    #[pyo3(get)]
    pub center: [f64; 3],
    /// Largest absolute coordinate relative to the center [m].
    pub extent: f32,
    /// Vertex positions relative to the center [m].
    pub vertices: Vec<Vec3>,
    /// Vertex indices of each face.
    pub faces: Vec<[u32; 3]>,
    /// Unit vertex normals.
    pub normals: Vec<Vec3>,
    /// The hierarchy.
    pub bvh: Bvh,
    /// True if `normals` are those of the current vertices.
    pub has_normals: bool,
    /// Faces around each vertex: `around[start[v]..start[v + 1]]`.
    start: Vec<u32>,
    around: Vec<u32>,
    /// Normals of faces, with twice the area as length; a reused buffer.
    area_normals: Vec<Vec3A>,
    /// Vertices of an earlier state; a reused buffer.
    spare: Vec<Vec3>,
}

impl Wall {
    /// Converts a point from the outside world to coordinates relative to this wall's center.
    pub fn localize(&self, point: [f64; 3]) -> Vec3 {
        [0, 1, 2].map(|k| (point[k] - self.center[k]) as f32)
    }

    /// Converts a point relative to this wall's center to the outside world.
    pub fn globalize(&self, point: Vec3) -> [f64; 3] {
        [0, 1, 2].map(|k| f64::from(point[k]) + self.center[k])
    }

    /// Faces around a vertex.
    pub fn faces_around(&self, vertex: usize) -> &[u32] {
        &self.around[self.start[vertex] as usize..self.start[vertex + 1] as usize]
    }

    /// Area of the faces around a vertex [m²].
    pub fn area_around(&self, vertex: usize) -> f32 {
        let length = |&f: &u32| self.area_normals[f as usize].length();
        0.5 * self.faces_around(vertex).iter().map(length).sum::<f32>()
    }

    /// Moves the wall to new vertices relative to its center and updates all derived data.
    fn move_to(&mut self, place: impl Fn(usize) -> Vec3 + Sync) -> Result<(), &'static str> {
        install(|| {
            self.set_vertices(self.vertices.len(), &place, &[])?;
            self.refit_changed();
            Ok(())
        })
    }

    /// Moves the wall without its vertex normals, which only a renderer needs: to `place`, except
    /// `others`, which are given with their positions.
    pub fn follow(
        &mut self,
        place: impl Fn(usize) -> Vec3 + Sync,
        others: &[(u32, Vec3)],
    ) -> Result<(), &'static str> {
        install(|| {
            self.set_vertices(self.vertices.len(), &place, others)?;
            self.bvh.refit(&self.vertices);
            self.has_normals = false;
            Ok(())
        })
    }

    /// Moves the wall like `follow` if only these vertices may have moved.
    pub fn follow_some(&mut self, moved: &[(u32, Vec3)]) -> Result<(), &'static str> {
        let size = |p: Vec3| p[0].abs().max(p[1].abs()).max(p[2].abs());
        if !moved.iter().flat_map(|(_, p)| p).all(|x| x.is_finite()) {
            return Err(BAD_VERTICES);
        }
        for &(v, place) in moved {
            self.vertices[v as usize] = place;
            self.extent = self.extent.max(size(place));
        }
        let Wall { vertices, bvh, start, around, .. } = self;
        let faces = moved.iter().flat_map(|&(v, _)| {
            around[start[v as usize] as usize..start[v as usize + 1] as usize].iter().copied()
        });
        bvh.refit_some(vertices, faces);
        self.has_normals = false;
        Ok(())
    }

    /// Unit normal of a vertex, even if vertex normals are outdated.
    pub fn normal(&self, vertex: u32) -> Vec3 {
        let v = vertex as usize;
        let sum = self.faces_around(v).iter().fold([0.0; 3], |sum, &face| {
            let [a, b, c] = self.faces[face as usize].map(|v| self.vertices[v as usize]);
            add(sum, cross(sub(b, a), sub(c, a)))
        });
        normalize(sum)
    }

    /// Sets the vertices if all are finite; else changes nothing.
    fn set_vertices(
        &mut self,
        count: usize,
        place: &(impl Fn(usize) -> Vec3 + Sync),
        others: &[(u32, Vec3)],
    ) -> Result<(), &'static str> {
        self.spare.resize(count, [0.0; 3]);
        let places = self.spare.par_iter_mut().with_min_len(4096).enumerate();
        let sizes = places.map(|(v, vertex)| {
            *vertex = place(v);
            vertex.map(f32::abs)
        });
        // Comparisons with NaN are false, so a NaN remains the largest size.
        let larger = |a: f32, b: f32| if a < b || b.is_nan() { b } else { a };
        let largest = |[x, y, z]: Vec3| larger(larger(x, y), z);
        let mut extent = sizes.map(largest).reduce(|| 0.0, larger);
        for &(v, other) in others {
            self.spare[v as usize] = other;
            extent = larger(extent, largest(other.map(f32::abs)));
        }
        if !extent.is_finite() {
            return Err(BAD_VERTICES);
        }
        std::mem::swap(&mut self.vertices, &mut self.spare);
        self.extent = extent;
        Ok(())
    }

    /// Updates the vertex normals to the current vertices.
    pub fn renew_normals(&mut self) {
        if !self.has_normals {
            install(|| {
                find_area_normals(&self.vertices, &self.faces, &mut self.area_normals);
                self.update_normals();
            });
            self.has_normals = true;
        }
    }

    /// Refits hierarchy and vertex normals.
    fn refit_all(&mut self) {
        let (bvh, vertices, faces) = (&mut self.bvh, &self.vertices, &self.faces);
        let area_normals = &mut self.area_normals;
        rayon::join(|| bvh.refit(vertices), || find_area_normals(vertices, faces, area_normals));
        self.update_normals();
        self.has_normals = true;
    }

    /// Area-weighted vertex normals, from those of the faces.
    fn update_normals(&mut self) {
        let (start, around, area_normals) = (&self.start, &self.around, &self.area_normals);
        let eights = self.normals.par_chunks_mut(EIGHT).with_min_len(512).enumerate();
        eights.for_each(|(number, normals)| {
            let first = EIGHT * number;
            let (mut x, mut y, mut z) = ([0.0; EIGHT], [0.0; EIGHT], [0.0; EIGHT]);
            for i in 0..normals.len() {
                let faces = &around[start[first + i] as usize..start[first + i + 1] as usize];
                [x[i], y[i], z[i]] = normal_sum(faces, area_normals);
            }
            for i in 0..EIGHT {
                [x[i], y[i], z[i]] = normalize([x[i], y[i], z[i]]);
            }
            for (i, normal) in normals.iter_mut().enumerate() {
                *normal = [x[i], y[i], z[i]];
            }
        });
    }
}

/// Computes normals of faces, with twice the area as length.
fn find_area_normals(vertices: &[Vec3], faces: &[[u32; 3]], normals: &mut [Vec3A]) {
    let places = normals.par_iter_mut().zip(faces).with_min_len(4096);
    places.for_each(|(normal, face)| *normal = area_normal(vertices, face));
}

/// Normal of a face, with twice the area as length.
#[inline(always)]
fn area_normal(vertices: &[Vec3], face: &[u32; 3]) -> Vec3A {
    let [a, b, c] = face.map(|v| Vec3A::from_vec4(vertex(vertices.as_flattened(), v)));
    (b - a).cross(c - a)
}

/// Area-weighted normal of a vertex, from those of the faces around it; not normalized.
#[inline(always)]
fn normal_sum(around: &[u32], area_normals: &[Vec3A]) -> Vec3 {
    around.iter().fold(Vec3A::ZERO, |sum, &f| sum + area_normals[f as usize]).to_array()
}

/// Distinct indices below `count`, in order.
fn distinct(count: usize, numbers: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut occurs = vec![false; count];
    numbers.for_each(|number| occurs[number as usize] = true);
    (0..count as u32).filter(|&number| occurs[number as usize]).collect()
}

fn faces_around(faces: &[[u32; 3]], num_vertices: usize) -> (Vec<u32>, Vec<u32>) {
    let mut start = vec![0u32; num_vertices + 1];
    for &v in faces.iter().flatten() {
        start[v as usize + 1] += 1;
    }
    for v in 0..num_vertices {
        start[v + 1] += start[v];
    }
    let mut next = start.clone();
    let mut around = vec![0u32; faces.len() * 3];
    for (f, face) in faces.iter().enumerate() {
        for &v in face {
            around[next[v as usize] as usize] = f as u32;
            next[v as usize] += 1;
        }
    }
    (start, around)
}

fn middle(vertices: &[f64]) -> [f64; 3] {
    [0, 1, 2].map(|k| {
        let column = vertices.iter().skip(k).step_by(3);
        let (low, high) = column.fold((f64::MAX, f64::MIN), |(a, b), &x| (a.min(x), b.max(x)));
        0.5 * (low + high)
    })
}

/// A vertex relative to a center, in single precision.
#[inline(always)]
fn about(center: [f64; 3], vertex: &[f64; 3]) -> Vec3 {
    [0, 1, 2].map(|k| (vertex[k] - center[k]) as f32)
}

const BAD_VERTICES: &str =
    "Wall vertices must be finite numbers, C-contiguous and of shape (n, 3).";

fn flat<'a>(vertices: &'a PyReadonlyArray2<'_, f64>) -> PyResult<&'a [f64]> {
    let shaped = |numbers: &&[f64]| vertices.as_array().ncols() == 3 && !numbers.is_empty();
    vertices.as_slice().ok().filter(shaped).ok_or_else(|| PyValueError::new_err(BAD_VERTICES))
}

#[pymethods]
impl Wall {
    /// Builds the wall from vertices [n 3] in meters and faces [m 3].
    #[new]
    fn new(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f64>,
        faces: PyReadonlyArray2<'_, i64>,
    ) -> PyResult<Self> {
        let vertices = flat(&vertices)?;
        let (rows, num_vertices) = (faces.as_array(), vertices.len() / 3);
        let valid = |&v: &i64| v >= 0 && (v as usize) < num_vertices;
        if rows.ncols() != 3 || rows.nrows() == 0 || !rows.iter().all(valid) {
            return Err(PyValueError::new_err(format!(
                "Wall faces must be of shape (m, 3) with vertex numbers below {num_vertices}."
            )));
        }
        let faces: Vec<[u32; 3]> =
            rows.outer_iter().map(|r| [r[0] as u32, r[1] as u32, r[2] as u32]).collect();
        let (start, around) = faces_around(&faces, num_vertices);
        let mut wall = Wall {
            center: middle(vertices),
            extent: 0.0,
            vertices: Vec::new(),
            normals: vec![[0.0; 3]; num_vertices],
            bvh: Bvh::empty(),
            has_normals: false,
            start,
            around,
            area_normals: vec![Vec3A::ZERO; faces.len()],
            faces,
            spare: Vec::new(),
        };
        let (center, (rows, _)) = (wall.center, vertices.as_chunks());
        detached(py, || {
            wall.set_vertices(num_vertices, &|v| about(center, &rows[v]), &[])?;
            wall.bvh = Bvh::build(&wall.vertices, &wall.faces);
            wall.refit_all();
            Ok(())
        })
        .map_err(PyValueError::new_err::<&str>)?;
        if wall.bvh.depth() > DEEPEST {
            return Err(PyValueError::new_err(format!(
                "Triangles of a wall lie within each other's bounds {} levels deep. Allowed: \
                 {DEEPEST}. Leave out those that are far smaller than the rest.",
                wall.bvh.depth()
            )));
        }
        Ok(wall)
    }

    /// An independent copy of this wall in its current state.
    fn copy(&self) -> Self {
        self.clone()
    }

    /// Moves the wall to new vertex positions [n 3] in meters; the hierarchy is refitted.
    fn refit(&mut self, py: Python<'_>, vertices: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let vertices = flat(&vertices)?;
        if vertices.len() != self.vertices.len() * 3 {
            return Err(PyValueError::new_err(format!(
                "Refitting needs {} vertices, was given {}.",
                self.vertices.len(),
                vertices.len() / 3
            )));
        }
        let (center, (rows, _)) = (self.center, vertices.as_chunks());
        py.detach(|| self.move_to(|v| about(center, &rows[v]))).map_err(PyValueError::new_err)
    }

    /// Nearest hit of rays: distance in units of the direction's length (NaN for none), face (−1).
    fn cast<'py>(
        &self,
        py: Python<'py>,
        origins: PyReadonlyArray2<'_, f64>,
        directions: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<DistanceAndFace<'py>> {
        let (origins, directions) = (origins.as_array(), directions.as_array());
        if origins.dim() != directions.dim() || origins.ncols() != 3 {
            return Err(PyValueError::new_err(
                "Origins and directions must both be of shape (n, 3).",
            ));
        }
        let rays: Vec<(Vec3, Vec3)> = origins
            .outer_iter()
            .zip(directions.outer_iter())
            .map(|(o, d)| {
                (self.localize([o[0], o[1], o[2]]), [d[0] as f32, d[1] as f32, d[2] as f32])
            })
            .collect();
        let found: Vec<(f32, i64)> =
            map(py, &rays, PART, |&(o, d)| match query::cast(&self.bvh, o, d) {
                Some((t, face)) => (t, i64::from(face)),
                None => (f32::NAN, -1),
            });
        let (distance, face): (Vec<f32>, Vec<i64>) = found.into_iter().unzip();
        Ok((distance.into_pyarray(py), face.into_pyarray(py)))
    }

    /// Nearest point of the wall to each point [n 3], and its face.
    fn closest_point<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<PlaceAndFace<'py>> {
        let points = self.local_points(&points)?;
        let nearest = map(py, &points, PART, |&p| query::nearest(&self.bvh, p));
        let mut places = Array2::zeros((nearest.len(), 3));
        for (mut row, found) in places.outer_iter_mut().zip(&nearest) {
            row.iter_mut().zip(self.globalize(found.point)).for_each(|(x, value)| *x = value);
        }
        let faces: Vec<i64> = nearest.iter().map(|found| i64::from(found.face)).collect();
        Ok((places.into_pyarray(py), faces.into_pyarray(py)))
    }

    /// Distance of each point [n 3] to the wall [m], positive inside the lumen.
    fn signed_distance<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let points = self.local_points(&points)?;
        let signed = |&p: &Vec3| {
            let distance = query::nearest(&self.bvh, p).distance;
            if query::is_inside(&self.bvh, p) { distance } else { -distance }
        };
        let distance = map(py, &points, PART, signed);
        Ok(distance.into_pyarray(py))
    }

    /// `true` where the segment from `origin` to a point [n 3] of the wall is unoccluded.
    fn visible<'py>(
        &self,
        py: Python<'py>,
        origin: [f64; 3],
        points: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let points = self.local_points(&points)?;
        let origin = self.localize(origin);
        Ok(detached(py, || visibility::visible(self, origin, &points)).into_pyarray(py))
    }

    /// Unit vertex normals [n 3], the area-weighted mean over the faces around each vertex.
    fn vertex_normals<'py>(&mut self, py: Python<'py>) -> Bound<'py, PyArray2<f32>> {
        self.renew_normals();
        let flat: Vec<f32> = self.normals.iter().flatten().copied().collect();
        Array2::from_shape_vec((self.normals.len(), 3), flat)
            .expect("three coordinates per vertex")
            .into_pyarray(py)
    }
}

impl Wall {
    fn local_points(&self, points: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Vec3>> {
        let rows = points.as_array();
        if rows.ncols() != 3 {
            return Err(PyValueError::new_err("Points must be of shape (n, 3)."));
        }
        Ok(rows.outer_iter().map(|r| self.localize([r[0], r[1], r[2]])).collect())
    }
}
