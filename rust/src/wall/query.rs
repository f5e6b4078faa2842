//! Queries for single rays and points.

use crate::simd::f32x64::{Vec3, add, cross, dot, max, min, scale, sub};
use crate::wall::bvh::{Bvh, Child, Triangle, WIDER, WIDTH, inverse};

/// Directions for the inside test: no mesh is aligned with all of them.
const PROBES: [Vec3; 3] = [[0.391, 0.664, 0.637], [-0.772, 0.253, 0.583], [0.214, -0.869, -0.446]];

/// The nearest point of the wall.
#[derive(Clone, Copy)]
pub struct Nearest {
    /// Position [m].
    pub point: Vec3,
    /// Distance [m].
    pub distance: f32,
    /// Face on which it lies.
    pub face: u32,
}

/// Nearest hit of one ray: distance in units of the direction's length, and face.
pub fn cast(bvh: &Bvh, origin: Vec3, direction: Vec3) -> Option<(f32, u32)> {
    hit(bvh, origin, direction).map(|(t, triangle)| (t, triangle.face))
}

/// True if a point lies in the lumen: most probe rays first hit the wall's inner side.
pub fn is_inside(bvh: &Bvh, point: Vec3) -> bool {
    let votes = PROBES.iter().filter(|&&probe| {
        hit(bvh, point, probe).is_some_and(|(_, triangle)| {
            let [a, b, c] = triangle.corners;
            dot(cross(sub(b, a), sub(c, a)), probe) < 0.0
        })
    });
    votes.count() >= 2
}

fn hit(bvh: &Bvh, origin: Vec3, direction: Vec3) -> Option<(f32, &Triangle)> {
    let inverse = direction.map(inverse);
    let mut best = f32::INFINITY;
    let mut found = None;
    let mut stack = vec![(0u32, 0.0f32)];
    while let Some((code, nearest)) = stack.pop() {
        if nearest > best {
            continue;
        }
        match Child::of(code) {
            Child::Leaf(range) => {
                for triangle in &bvh.triangles[range] {
                    if let Some(t) = intersect(triangle, origin, direction).filter(|&t| t < best) {
                        best = t;
                        found = Some((t, triangle));
                    }
                }
            }
            Child::Node(number) => {
                let node = &bvh.nodes[number];
                let (mut near, mut far) = ([0.0f32; WIDTH], [f32::INFINITY; WIDTH]);
                for axis in 0..3 {
                    for k in 0..WIDTH {
                        let a = (node.bounds[axis][k] - origin[axis]) * inverse[axis];
                        let b = (node.bounds[axis + 3][k] - origin[axis]) * inverse[axis];
                        near[k] = max(near[k], min(a, b));
                        far[k] = min(far[k], max(a, b) * WIDER);
                    }
                }
                let used = |k: &usize| node.bounds[0][*k] <= node.bounds[3][*k];
                push_sorted(&mut stack, node.children, near, |k| {
                    used(&k) && near[k] <= far[k] && near[k] <= best
                });
            }
        }
    }
    found
}

fn intersect(triangle: &Triangle, origin: Vec3, direction: Vec3) -> Option<f32> {
    let [a, b, c] = triangle.corners.map(|corner| sub(corner, origin));
    let edges =
        [dot(cross(b, c), direction), dot(cross(c, a), direction), dot(cross(a, b), direction)];
    let inside = edges.iter().all(|&e| e >= 0.0) || edges.iter().all(|&e| e <= 0.0);
    let normal = cross(sub(b, a), sub(c, a));
    let t = dot(normal, a) / dot(normal, direction);
    (inside && t > 0.0 && t.is_finite()).then_some(t)
}

/// The nearest point of the wall to `point`.
pub fn nearest(bvh: &Bvh, point: Vec3) -> Nearest {
    let mut best = Nearest { point, distance: f32::INFINITY, face: 0 };
    let mut best_square = f32::INFINITY;
    let mut stack = vec![(0u32, 0.0f32)];
    while let Some((code, square)) = stack.pop() {
        if square > best_square {
            continue;
        }
        match Child::of(code) {
            Child::Leaf(range) => {
                for triangle in &bvh.triangles[range] {
                    let place = nearest_on_triangle(triangle.corners, point);
                    let offset = sub(place, point);
                    let square = dot(offset, offset);
                    if square < best_square {
                        best_square = square;
                        best =
                            Nearest { point: place, distance: square.sqrt(), face: triangle.face };
                    }
                }
            }
            Child::Node(number) => {
                let node = &bvh.nodes[number];
                let mut square = [0.0f32; WIDTH];
                for axis in 0..3 {
                    for k in 0..WIDTH {
                        let below = node.bounds[axis][k] - point[axis];
                        let above = point[axis] - node.bounds[axis + 3][k];
                        let outside = max(max(below, above), 0.0);
                        square[k] += outside * outside;
                    }
                }
                push_sorted(&mut stack, node.children, square, |k| {
                    node.bounds[0][k] <= node.bounds[3][k] && square[k] <= best_square
                });
            }
        }
    }
    best
}

/// Pushes the children that pass `wanted`, the one with the smallest key last.
fn push_sorted(
    stack: &mut Vec<(u32, f32)>,
    children: [u32; WIDTH],
    key: [f32; WIDTH],
    wanted: impl Fn(usize) -> bool,
) {
    let first = stack.len();
    stack.extend((0..WIDTH).filter(|&k| wanted(k)).map(|k| (children[k], key[k])));
    stack[first..].sort_by(|a, b| b.1.total_cmp(&a.1));
}

/// Nearest point of a triangle (Ericson 2004, Real-Time Collision Detection, 5.1.5).
fn nearest_on_triangle([a, b, c]: [Vec3; 3], p: Vec3) -> Vec3 {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let [ap, bp, cp] = [a, b, c].map(|corner| sub(p, corner));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return add(a, scale(ab, d1 / (d1 - d3)));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return add(a, scale(ac, d2 / (d2 - d6)));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let along = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return add(b, scale(sub(c, b), along));
    }
    let inverse = 1.0 / (va + vb + vc);
    add(a, add(scale(ab, vb * inverse), scale(ac, vc * inverse)))
}
