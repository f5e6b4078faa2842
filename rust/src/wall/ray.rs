//! Single-ray traversal of the hierarchy, for rays without neighbors.

use crate::simd::f32x64::*;
use crate::wall::bvh::{Bvh, Child, Node, STACK, Triangle, WIDER, WIDTH, inverse};
use crate::wall::packet::MISS;
use glam::Vec4;

/// Hit of a ray on the wall.
#[derive(Clone, Copy)]
pub struct Hit {
    /// Distance along the ray [m].
    pub distance: f32,
    /// Triangle in leaf order.
    pub triangle: u32,
    /// Edge functions as in `packet::Hits::edges`.
    pub edges: Vec3,
    /// Index in `Contents::chyme` of a particle hit before any triangle; `MISS` for none.
    pub particle: u32,
}

/// A ray, prepared for tests against boxes and triangles.
struct Ray {
    origin: Vec3,
    inverse: Vec3,
    /// Rows of `Node::bounds` where the ray enters a box; it leaves by the others.
    enter: [usize; 3],
    leave: [usize; 3],
    /// Axes in an order that ends with the one of the largest direction component.
    axes: [usize; 3],
    /// Shift of the ray along the first two axes per unit of the last, and its length per unit.
    shear: Vec3,
}

/// Boxes of a node's children that a ray intersects.
struct BoxesMet {
    nearest: [f32; WIDTH],
    /// One bit for each child.
    mask: u32,
}

impl Ray {
    #[inline(always)]
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let inverse = direction.map(inverse);
        let row = |axis: usize, far: bool| axis + if (inverse[axis] > 0.0) == far { 3 } else { 0 };
        let rows = |far| [row(0, far), row(1, far), row(2, far)];
        let [x, y, z] = direction.map(f32::abs);
        let last = if z >= x && z >= y { 2 } else { usize::from(y >= x) };
        let axes = [(last + 1) % 3, (last + 2) % 3, last];
        let per_unit = inverse[last];
        let shear = [direction[axes[0]] * per_unit, direction[axes[1]] * per_unit, per_unit];
        Ray { origin, inverse, enter: rows(false), leave: rows(true), axes, shear }
    }

    /// Children whose boxes the ray intersects nearer than `farthest`.
    #[inline(always)]
    fn boxes_met(&self, node: &Node, farthest: f32) -> BoxesMet {
        let mut out = BoxesMet { nearest: [0.0; WIDTH], mask: 0 };
        let (origin, inverse) = (self.origin.map(Vec4::splat), self.inverse.map(Vec4::splat));
        for half in [0, 4] {
            let at = |rows: [usize; 3]| {
                let distance = |k: usize| {
                    let bound = Vec4::from_slice(&node.bounds[rows[k]][half..half + 4]);
                    (bound - origin[k]) * inverse[k]
                };
                [distance(0), distance(1), distance(2)]
            };
            let ([ex, ey, ez], [lx, ly, lz]) = (at(self.enter), at(self.leave));
            let nearest = ex.max(ey).max(ez).max(Vec4::ZERO);
            let leave = lx.min(ly).min(lz) * Vec4::splat(WIDER);
            let meets = nearest.cmple(leave.min(Vec4::splat(farthest)));
            nearest.write_to_slice(&mut out.nearest[half..half + 4]);
            out.mask |= meets.bitmask() << half;
        }
        out
    }

    /// Distance and edge functions, if the ray hits the triangle nearer than `farthest` (Woop,
    /// Benthin and Wald 2013: watertight, because neighbors share the values of their edge).
    #[inline(always)]
    fn meet(&self, triangle: &Triangle, farthest: f32) -> Option<(f32, Vec3)> {
        let [kx, ky, kz] = self.axes;
        let [sx, sy, sz] = self.shear;
        let o = self.origin;
        let [(ax, ay, az), (bx, by, bz), (cx, cy, cz)] = triangle.corners.map(|corner| {
            let along = corner[kz] - o[kz];
            (corner[kx] - o[kx] - sx * along, corner[ky] - o[ky] - sy * along, along)
        });
        let (u, v, w) = (bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx);
        if (min(u, min(v, w)) < 0.0) & (max(u, max(v, w)) > 0.0) {
            return None;
        }
        let sum = u + v + w;
        let t = (u * az + v * bz + w * cz) * sz / sum;
        ((t > 0.0) & (t < farthest)).then_some((t, [u, v, sum].map(|e| e * sz)))
    }
}

/// Stack of nodes to visit, with the entry distance of a ray into each [m].
pub struct Pile([(u32, f32); STACK]);

impl Default for Pile {
    fn default() -> Self {
        Pile([(0, 0.0); STACK])
    }
}

/// Nearest hit within `reach` [m] of a ray with a unit direction, except on triangle `from`.
///
/// With `ANY` the first hit found is returned.
#[inline(always)]
pub fn cast<const ANY: bool>(
    bvh: &Bvh,
    origin: Vec3,
    direction: Vec3,
    reach: f32,
    from: u32,
) -> Option<Hit> {
    cast_in::<ANY>(&mut Pile::default(), bvh, (origin, direction), reach, from)
}

/// Casts like `cast` with a stack that is reused for many rays.
#[inline(always)]
pub fn cast_in<const ANY: bool>(
    Pile(stack): &mut Pile,
    bvh: &Bvh,
    (origin, direction): (Vec3, Vec3),
    reach: f32,
    from: u32,
) -> Option<Hit> {
    let ray = Ray::new(origin, direction);
    let (mut top, mut code) = (0, 0u32);
    let mut farthest = reach;
    let mut found = None;
    loop {
        match Child::of(code) {
            Child::Node(number) => {
                let node = &bvh.nodes[number];
                let boxes_met = ray.boxes_met(node, farthest);
                if boxes_met.mask != 0 {
                    (code, top) = choose(node, &boxes_met, stack, top);
                    continue;
                }
            }
            Child::Leaf(range) => {
                for number in range.filter(|&n| n as u32 != from) {
                    if let Some((distance, edges)) = ray.meet(&bvh.triangles[number], farthest) {
                        farthest = distance;
                        found =
                            Some(Hit { distance, triangle: number as u32, edges, particle: MISS });
                        if ANY {
                            return found;
                        }
                    }
                }
            }
        }
        // Nearest node first; nodes beyond the hit are dropped.
        loop {
            if top == 0 {
                return found;
            }
            top -= 1;
            if stack[top].1 <= farthest {
                break;
            }
        }
        code = stack[top].0;
    }
}

/// Returns the nearest intersected child and pushes the others, the nearest last.
#[inline(always)]
fn choose(
    node: &Node,
    boxes_met: &BoxesMet,
    stack: &mut [(u32, f32); STACK],
    mut top: usize,
) -> (u32, usize) {
    let mut mask = boxes_met.mask;
    let mut next = || {
        let k = mask.trailing_zeros() as usize % WIDTH;
        mask &= mask - 1;
        ((node.children[k], boxes_met.nearest[k]), mask)
    };
    let (mut best, mut rest) = next();
    let first = top;
    while rest != 0 {
        let other;
        (other, rest) = next();
        let is_nearer = other.1 < best.1;
        let later = if is_nearer { best } else { other };
        best = if is_nearer { other } else { best };
        let mut place = top;
        while place > first && stack[place - 1].1 < later.1 {
            stack[place] = stack[place - 1];
            place -= 1;
        }
        stack[place] = later;
        top += 1;
    }
    (best.0, top)
}
