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
}

impl NearbyWall {
    /// Faces within `reach` of the axis, vertices within the `wider` reach [m].
    pub fn find(&mut self, wall: &Wall, axis: &Axis, reach: f64, wider: f64) {
        let mut faces = Vec::new();
        let mut around = Vec::new();
        for face in faces_in_box(&wall.bvh, axis, reach.max(wider)) {
            let corners = wall.faces[face as usize];
            let distance = |v: u32| {
                let p = point(wall, v);
                (p - axis.nearest(p)).length()
            };
            let [a, b, c] = corners.map(|v| point(wall, v));
            let longest = (b - a).length().max((c - b).length()).max((a - c).length());
            let nearest = corners.map(distance).into_iter().fold(f64::INFINITY, f64::min);
            // No point of a triangle is farther from its nearest corner than its longest edge.
            if nearest - longest <= reach {
                faces.push(face);
            }
            around.extend(corners.into_iter().filter(|&v| distance(v) <= wider));
        }
        faces.sort_unstable();
        around.sort_unstable();
        around.dedup();
        self.around = around;
        self.vertices = faces.iter().flat_map(|&f| wall.faces[f as usize]).collect();
        self.vertices.sort_unstable();
        self.vertices.dedup();
        let place = |v: u32| self.vertices.binary_search(&v).expect("a corner of the face") as u32;
        self.corners = faces.iter().map(|&f| wall.faces[f as usize].map(place)).collect();
        self.faces = faces;
    }
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
                let meets = |k: &usize| {
                    (0..3).all(|axis| {
                        node.bounds[axis][*k] <= high[axis]
                            && node.bounds[axis + 3][*k] >= low[axis]
                    })
                };
                stack.extend((0..WIDTH).filter(meets).map(|k| node.children[k]));
            }
        }
    }
    found
}
