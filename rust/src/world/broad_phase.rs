//! What of the wall is near the capsule: found in the hierarchy now and then, used every substep.

use super::body::Axis;
use crate::wall::Wall;
use crate::wall::bvh::{Bvh, Child, WIDTH};
use glam::DVec3;

/// Triangles that may touch before the next search, and the vertices around.
#[derive(Default)]
pub struct NearbyWall {
    /// Numbers of the faces, rising.
    pub faces: Vec<u32>,
    /// The faces as places of their corners in `vertices`.
    pub corners: Vec<[u32; 3]>,
    /// Vertices of these faces, by rising number.
    pub vertices: Vec<u32>,
    /// All vertices within the wider reach, by rising number.
    pub around: Vec<u32>,
    looked_at: LookedAt,
}

/// Distances of vertices from the axis in one search, so that each is found once.
#[derive(Default)]
struct LookedAt {
    number: u32,
    /// In which search, and how far [m].
    distances: Vec<(u32, f64)>,
}

impl NearbyWall {
    /// Faces within `reach` of the axis, vertices within the `wider` reach [m].
    pub fn find(&mut self, wall: &Wall, axis: &Axis, reach: f64, wider: f64) {
        self.faces.clear();
        self.around.clear();
        let mut looked_at = std::mem::take(&mut self.looked_at);
        looked_at.begin(wall.vertices.len());
        for face in faces_in_box(&wall.bvh, axis, reach.max(wider)) {
            let corners = wall.faces[face as usize];
            let mut nearest = f64::INFINITY;
            for v in corners {
                let (distance, is_new) = looked_at.distance(wall, v, axis);
                nearest = nearest.min(distance);
                if is_new && distance <= wider {
                    self.around.push(v);
                }
            }
            // No point of a triangle is farther from its nearest corner than its longest edge.
            if nearest <= reach || nearest - longest_edge(wall, corners) <= reach {
                self.faces.push(face);
            }
        }
        self.looked_at = looked_at;
        self.faces.sort_unstable();
        self.around.sort_unstable();
        let corners = self.faces.iter().flat_map(|&f| wall.faces[f as usize]);
        self.vertices.clear();
        self.vertices.extend(corners);
        self.vertices.sort_unstable();
        self.vertices.dedup();
        let place = |v: u32| self.vertices.binary_search(&v).expect("a corner of the face") as u32;
        self.corners.clear();
        self.corners.extend(self.faces.iter().map(|&f| wall.faces[f as usize].map(place)));
    }
}

impl LookedAt {
    fn begin(&mut self, num_vertices: usize) {
        self.number = self.number.wrapping_add(1);
        if self.distances.len() != num_vertices || self.number == 0 {
            self.distances = vec![(0, 0.0); num_vertices];
            self.number = 1;
        }
    }

    /// Distance of a vertex from the axis [m], and whether it is asked for the first time.
    #[inline(always)]
    fn distance(&mut self, wall: &Wall, v: u32, axis: &Axis) -> (f64, bool) {
        let known = &mut self.distances[v as usize];
        let is_new = known.0 != self.number;
        if is_new {
            let p = point(wall, v);
            *known = (self.number, (p - axis.nearest(p)).length());
        }
        (known.1, is_new)
    }
}

fn longest_edge(wall: &Wall, corners: [u32; 3]) -> f64 {
    let [a, b, c] = corners.map(|v| point(wall, v));
    (b - a).length().max((c - b).length()).max((a - c).length())
}

/// A vertex of the wall in double precision, about the wall's center.
pub fn point(wall: &Wall, vertex: u32) -> DVec3 {
    let [x, y, z] = wall.vertices[vertex as usize];
    DVec3::new(f64::from(x), f64::from(y), f64::from(z))
}

/// Faces whose leaf lies in the box around the axis, grown by `reach` [m].
fn faces_in_box(bvh: &Bvh, axis: &Axis, reach: f64) -> Vec<u32> {
    let end = axis.start + axis.span;
    let low = (axis.start.min(end) - reach).to_array().map(|x| x as f32);
    let high = (axis.start.max(end) + reach).to_array().map(|x| x as f32);
    let (mut found, mut stack) = (Vec::new(), vec![0u32]);
    while let Some(code) = stack.pop() {
        match Child::of(code) {
            Child::Leaf(range) => found.extend(bvh.triangles[range].iter().map(|t| t.face)),
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
    found
}
