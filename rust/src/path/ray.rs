//! One ray through the hierarchy, for rays that have no neighbours.

use crate::bvh::{Bvh, Child, Node, Triangle, WIDTH};
use crate::lanes::*;

/// Deepest pile of nodes waiting to be visited: 7 per level of a tree of depth 32.
const STACK: usize = 7 * 32 + 8;
/// Widens a box by the rounding of its distances.
const WIDER: f32 = 1.0 + 4.0 * f32::EPSILON;

/// Where a ray meets the wall.
#[derive(Clone, Copy)]
pub struct Hit {
    /// Distance along the ray [m].
    pub distance: f32,
    /// Triangle in leaf order.
    pub triangle: u32,
    /// As in `tile::Hits::edges`.
    pub edges: Vec3,
}

/// A ray, ready to be tested against boxes.
struct Slabs {
    origin: Vec3,
    inverse: Vec3,
    /// Rows of `Node::bounds` where the ray enters a box; it leaves by the others.
    enter: [usize; 3],
    leave: [usize; 3],
}

impl Slabs {
    #[inline(always)]
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let tiny = |d: f32| if d.abs() > 1e-20 { d } else { 1e-20f32.copysign(d) };
        let inverse = direction.map(|d| 1.0 / tiny(d));
        let row = |axis: usize, far: bool| axis + if (inverse[axis] > 0.0) == far { 3 } else { 0 };
        let rows = |far| [row(0, far), row(1, far), row(2, far)];
        Slabs { origin, inverse, enter: rows(false), leave: rows(true) }
    }

    /// Pushes the children whose boxes the ray meets nearer than `farthest`, the nearest last.
    #[inline(always)]
    fn push(
        &self,
        node: &Node,
        farthest: f32,
        stack: &mut [(u32, f32); STACK],
        mut top: usize,
    ) -> usize {
        let [ex, ey, ez] = self.enter.map(|row| &node.bounds[row]);
        let [lx, ly, lz] = self.leave.map(|row| &node.bounds[row]);
        let ([ox, oy, oz], [ix, iy, iz]) = (self.origin, self.inverse);
        let (mut nearest, mut touched) = ([0.0f32; WIDTH], [0u8; WIDTH]);
        for k in 0..WIDTH {
            let enter = max(max((ex[k] - ox) * ix, (ey[k] - oy) * iy), (ez[k] - oz) * iz);
            let leave = min(min((lx[k] - ox) * ix, (ly[k] - oy) * iy), (lz[k] - oz) * iz);
            nearest[k] = max(enter, 0.0);
            touched[k] = u8::from(nearest[k] <= min(leave * WIDER, farthest));
        }
        let mut touched = u64::from_le_bytes(touched);
        let first = top;
        while touched != 0 {
            let k = touched.trailing_zeros() as usize / 8;
            touched &= touched - 1;
            let mut place = top;
            while place > first && stack[place - 1].1 < nearest[k] {
                stack[place] = stack[place - 1];
                place -= 1;
            }
            stack[place] = (node.children[k], nearest[k]);
            top += 1;
        }
        top
    }
}

/// The nearest hit within `reach` [m] of a ray with a unit direction; not on triangle `from`.
///
/// With `ANY` the first hit found is taken.
#[inline(always)]
pub fn cast<const ANY: bool>(
    bvh: &Bvh,
    origin: Vec3,
    direction: Vec3,
    reach: f32,
    from: u32,
) -> Option<Hit> {
    let slabs = Slabs::new(origin, direction);
    let mut stack = [(0u32, 0.0f32); STACK];
    let mut top = 1;
    let mut farthest = reach;
    let mut found = None;
    while top > 0 {
        top -= 1;
        let (code, nearest) = stack[top];
        if nearest > farthest {
            continue;
        }
        match Child::of(code) {
            Child::Node(number) => {
                top = slabs.push(&bvh.nodes[number], farthest, &mut stack, top);
            }
            Child::Leaf(range) => {
                for number in range.filter(|&n| n as u32 != from) {
                    let triangle = &bvh.triangles[number];
                    if let Some((distance, edges)) = meet(triangle, origin, direction, farthest) {
                        farthest = distance;
                        found = Some(Hit { distance, triangle: number as u32, edges });
                        if ANY {
                            return found;
                        }
                    }
                }
            }
        }
    }
    found
}

/// Distance and edge functions, if the ray meets the triangle nearer than `farthest`.
#[inline(always)]
fn meet(triangle: &Triangle, origin: Vec3, direction: Vec3, farthest: f32) -> Option<(f32, Vec3)> {
    let [a, b, c] = triangle.corners.map(|corner| sub(corner, origin));
    let u = dot(cross(b, c), direction);
    let v = dot(cross(c, a), direction);
    let w = dot(cross(a, b), direction);
    let inside = (min(u, min(v, w)) >= 0.0) | (max(u, max(v, w)) <= 0.0);
    if !inside {
        return None;
    }
    let normal = cross(sub(b, a), sub(c, a));
    let t = dot(normal, a) / dot(normal, direction);
    ((t > 0.0) & (t < farthest)).then_some((t, [u, v, u + v + w]))
}
