//! Part of the wall near the capsule, searched in the hierarchy only after enough travel.

use super::body::Axis;
use crate::wall::Wall;
use crate::wall::bvh::{Bvh, Child, Triangle, WIDTH};
use glam::DVec3;

/// Triangles that may come into contact before the next search.
#[derive(Default)]
pub struct NearbyWall {
    /// Indices of the faces, ascending.
    pub faces: Vec<u32>,
    /// Corners of the faces, as indices into `vertices`.
    pub corners: Vec<[u32; 3]>,
    /// Vertices of these faces, ascending.
    pub vertices: Vec<u32>,
    seen: Seen,
}

/// Vertices visited by a search, with their local indices.
#[derive(Default)]
struct Seen {
    search: u32,
    /// Last search that visited each vertex, and its local index.
    vertices: Vec<(u32, u32)>,
}

/// Axis-aligned bounding box.
#[derive(Clone, Copy)]
pub struct Bounds {
    low: DVec3,
    high: DVec3,
}

impl NearbyWall {
    /// Finds faces within `reach` of the axis [m].
    pub fn find(&mut self, wall: &Wall, axis: &Axis, reach: f64) {
        let NearbyWall { faces, corners, vertices, seen } = self;
        faces.clear();
        let bounds = Bounds::about([axis.start, axis.start + axis.span]);
        each_in_box(&wall.bvh, &bounds, reach, |triangle| {
            if is_within(triangle, axis, reach) {
                faces.push(triangle.face);
            }
        });
        faces.sort_unstable();
        seen.begin(wall.vertices.len());
        vertices.clear();
        let all = faces.iter().flat_map(|&f| wall.faces[f as usize]);
        vertices.extend(all.filter(|&v| seen.is_new(v)));
        vertices.sort_unstable();
        for (place, &v) in vertices.iter().enumerate() {
            seen.vertices[v as usize].1 = place as u32;
        }
        corners.clear();
        let place = |v: u32| seen.vertices[v as usize].1;
        corners.extend(faces.iter().map(|&f| wall.faces[f as usize].map(place)));
    }

    /// Appends the vertices within `reach` of a box [m], in no order.
    pub fn add_vertices(&mut self, wall: &Wall, bounds: &Bounds, reach: f64, to: &mut Vec<u32>) {
        let (seen, square) = (&mut self.seen, reach * reach);
        seen.begin(wall.vertices.len());
        each_in_box(&wall.bvh, bounds, reach, |triangle| {
            for (v, corner) in wall.faces[triangle.face as usize].into_iter().zip(triangle.corners)
            {
                if seen.is_new(v) && bounds.square_distance(wide(corner)) <= square {
                    to.push(v);
                }
            }
        });
    }
}

impl Seen {
    fn begin(&mut self, num_vertices: usize) {
        self.search = self.search.wrapping_add(1);
        if self.vertices.len() != num_vertices || self.search == 0 {
            self.vertices = vec![(0, 0); num_vertices];
            self.search = 1;
        }
    }

    /// Marks a vertex as visited; true if this search had not visited it.
    #[inline(always)]
    fn is_new(&mut self, v: u32) -> bool {
        std::mem::replace(&mut self.vertices[v as usize].0, self.search) != self.search
    }
}

impl Bounds {
    /// Bounding box of points; without points, it is at infinite distance.
    pub fn about(points: impl IntoIterator<Item = DVec3>) -> Self {
        let nothing = Bounds { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };
        points.into_iter().fold(nothing, |bounds, point| Bounds {
            low: bounds.low.min(point),
            high: bounds.high.max(point),
        })
    }

    /// Squared distance of a point from the box [m²], 0 inside.
    #[inline(always)]
    pub fn square_distance(&self, point: DVec3) -> f64 {
        (point - point.clamp(self.low, self.high)).length_squared()
    }
}

/// True if a triangle's bounding sphere is within `reach` of the axis.
#[inline(always)]
fn is_within(triangle: &Triangle, axis: &Axis, reach: f64) -> bool {
    let corners = triangle.corners.map(wide);
    let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
    let square = |corner: DVec3| (corner - middle).length_squared();
    let radius = square(corners[0]).max(square(corners[1])).max(square(corners[2])).sqrt();
    (middle - axis.nearest(middle)).length_squared() <= (reach + radius) * (reach + radius)
}

/// Point in double precision.
#[inline(always)]
fn wide([x, y, z]: [f32; 3]) -> DVec3 {
    DVec3::new(f64::from(x), f64::from(y), f64::from(z))
}

/// Vertex of the wall in double precision, relative to the wall's center.
pub fn point(wall: &Wall, vertex: u32) -> DVec3 {
    wide(wall.vertices[vertex as usize])
}

/// Visits the triangles of each leaf that meets a box grown by `reach` [m].
fn each_in_box(bvh: &Bvh, bounds: &Bounds, reach: f64, mut visit: impl FnMut(&Triangle)) {
    let low = (bounds.low - reach).to_array().map(|x| x as f32);
    let high = (bounds.high + reach).to_array().map(|x| x as f32);
    let mut stack = vec![0u32];
    while let Some(code) = stack.pop() {
        match Child::of(code) {
            Child::Leaf(range) => bvh.triangles[range].iter().for_each(&mut visit),
            Child::Node(number) => {
                let node = &bvh.nodes[number];
                let mut meets = [true; WIDTH];
                for axis in 0..3 {
                    for k in 0..WIDTH {
                        meets[k] &= node.bounds[axis][k] <= high[axis]
                            && node.bounds[axis + 3][k] >= low[axis];
                    }
                }
                stack.extend((0..WIDTH).filter(|&k| meets[k]).map(|k| node.children[k]));
            }
        }
    }
}
