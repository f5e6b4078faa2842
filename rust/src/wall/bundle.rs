//! Tracing of eight rays from one point as a bundle, for rays too far apart for a packet.
//!
//! A box of the hierarchy is tested against all rays at once, by intervals of their directions; a
//! triangle against each ray with the edge functions of `packet`, so that both find the same hits.

use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::bvh::{Bvh, Child, Node, STACK, Triangle, WIDER, WIDTH, inverse};
use crate::wall::packet::{Hits, Pyramid};
use crate::wall::visibility::SHADOW_REACH;
use glam::{BVec4A, Vec4};

/// Number of rays of a bundle.
pub const RAYS: usize = 8;
/// Columns and rows of a tile whose rays form a bundle.
const COLUMNS: usize = 4;
const ROWS: usize = RAYS / COLUMNS;
/// Larger than any distance.
const FAR: f32 = 1e30;

/// One value per ray, in halves that fit the narrowest vectors.
type Eight = [Vec4; 2];

/// Stack of nodes to visit, with the entry distance of a bundle into each.
type Pile = [(u32, f32); STACK];

/// Vectors from a point; a distance along one is a multiple of its length.
struct Bundle {
    point: Vec3,
    /// By component.
    ways: [Eight; 3],
    /// For each row of `Node::bounds`: factors from the offset of that bound along its axis to the
    /// minimum and maximum distance that it allows, and a term added to the latter. A row bounds
    /// one of the two; the other is then 0 or `FAR`.
    least: [f32; 6],
    greatest: [f32; 6],
    no_greatest: [f32; 6],
}

/// Intersections of a bundle with a triangle's plane, and the signs of its edge functions.
struct Meeting {
    /// A bit for each ray that hits the triangle.
    bits: u32,
    distance: Eight,
    edges: [Eight; 3],
}

/// Finds the nearest hits of the used rays of a tile.
#[inline(always)]
pub fn trace_in_bundles(
    wall: &Wall,
    origin: Vec3,
    rays: &Pyramid,
    used: &[bool; LANES],
    hits: &mut Hits,
) {
    let mut pile = [(0, 0.0); STACK];
    for row in (0..TILE).step_by(ROWS) {
        for column in (0..TILE).step_by(COLUMNS) {
            let lane = |k: usize| (row + k / COLUMNS) * TILE + column + k % COLUMNS;
            let Some(any) = (0..RAYS).map(lane).find(|&i| used[i]) else { continue };
            let mut ways = [[0.0; RAYS]; 3];
            for k in 0..RAYS {
                let way = at(&rays.directions, if used[lane(k)] { lane(k) } else { any });
                (ways[0][k], ways[1][k], ways[2][k]) = (way[0], way[1], way[2]);
            }
            Bundle::new(origin, &ways).nearest_hits(&wall.bvh, lane, hits, &mut pile);
        }
    }
}

/// Light sources, of up to `RAYS`, visible from each point of a tile, one bit each; none in lanes
/// not `used`. There are `count` sources; lane `i` has its own positions `source(i, k)`.
#[inline(always)]
pub fn lit_by(
    wall: &Wall,
    (count, source): (usize, impl Fn(usize, usize) -> Vec3),
    points: &Lane3,
    used: &[bool; LANES],
) -> [u32; LANES] {
    let (mut lit, mut pile) = ([0; LANES], [(0, 0.0); STACK]);
    for i in (0..LANES).filter(|&i| used[i] && count > 0) {
        let point = at(points, i);
        let mut ways = [[0.0; RAYS]; 3];
        for k in 0..RAYS {
            // The last one fills the rest.
            let way = sub(source(i, k.min(count - 1)), point);
            (ways[0][k], ways[1][k], ways[2][k]) = (way[0], way[1], way[2]);
        }
        lit[i] = Bundle::new(point, &ways).unoccluded(&wall.bvh, (1 << count) - 1, &mut pile);
    }
    lit
}

impl Bundle {
    #[inline(always)]
    fn new(point: Vec3, ways: &[[f32; RAYS]; 3]) -> Self {
        let (mut least, mut greatest, mut no_greatest) = ([0.0; 6], [0.0; 6], [FAR; 6]);
        for axis in 0..3 {
            let (mut low, mut high) = (f32::MAX, f32::MIN);
            for &way in &ways[axis] {
                low = min(low, way);
                high = max(high, way);
            }
            // Some ray is above a lower bound at a distance if the highest is; below an upper one
            // if the lowest is.
            for (row, way) in [(axis, high), (axis + 3, low)] {
                let inverse = inverse(way);
                if (inverse > 0.0) == (row == axis) {
                    least[row] = inverse;
                } else {
                    greatest[row] = inverse;
                    no_greatest[row] = 0.0;
                }
            }
        }
        let [x, y, z] = ways;
        Bundle { point, ways: [eight(x), eight(y), eight(z)], least, greatest, no_greatest }
    }

    /// Finds the nearest hits, lane by lane.
    #[inline(always)]
    fn nearest_hits(
        &self,
        bvh: &Bvh,
        lane: impl Fn(usize) -> usize,
        hits: &mut Hits,
        pile: &mut Pile,
    ) {
        let mut reach = [0.0; RAYS];
        for k in 0..RAYS {
            reach[k] = hits.distance[lane(k)];
        }
        let mut farthest = farthest_of(&reach);
        pile[0] = (0, 0.0);
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (code, nearest) = pile[top];
            if nearest > farthest {
                continue;
            }
            match Child::of(code) {
                Child::Node(number) => {
                    top = self.push_children(&bvh.nodes[number], farthest, pile, top);
                }
                Child::Leaf(range) => {
                    for number in range {
                        let met = self.meet(&bvh.triangles[number], 0.0, &eight(&reach));
                        let mut bits = met.bits;
                        while bits != 0 {
                            let k = bits.trailing_zeros() as usize % RAYS;
                            bits &= bits - 1;
                            let of = |eight: &Eight| eight[k / 4][k % 4];
                            let [u, v, w] =
                                [of(&met.edges[0]), of(&met.edges[1]), of(&met.edges[2])];
                            let i = lane(k);
                            reach[k] = of(&met.distance);
                            (hits.distance[i], hits.triangle[i]) = (reach[k], number as u32);
                            (hits.edges[0][i], hits.edges[1][i]) = (u, v);
                            hits.edges[2][i] = u + v + w;
                        }
                        if met.bits != 0 {
                            farthest = farthest_of(&reach);
                        }
                    }
                }
            }
        }
    }

    /// Rays among the bits `all` that are unoccluded up to their ends.
    #[inline(always)]
    fn unoccluded(&self, bvh: &Bvh, all: u32, pile: &mut Pile) -> u32 {
        let (mut lit, whole) = (all, [Vec4::ONE; 2]);
        pile[0] = (0, 0.0);
        let mut top = 1;
        while top > 0 {
            top -= 1;
            match Child::of(pile[top].0) {
                Child::Node(number) => {
                    top = self.push_children(&bvh.nodes[number], 1.0, pile, top);
                }
                Child::Leaf(range) => {
                    for triangle in &bvh.triangles[range] {
                        lit &= !self.meet(triangle, 1.0 - SHADOW_REACH, &whole).bits;
                    }
                    if lit == 0 {
                        return 0;
                    }
                }
            }
        }
        lit
    }

    /// Pushes the children that a ray may hit nearer than `farthest`, the nearest last.
    #[inline(always)]
    fn push_children(&self, node: &Node, farthest: f32, pile: &mut Pile, mut top: usize) -> usize {
        let (mut nearest, mut met) = ([0.0; WIDTH], 0);
        let p = self.point;
        for half in [0, 4] {
            let (mut near, mut far) = (Vec4::ZERO, Vec4::splat(FAR));
            for row in 0..6 {
                let bound = Vec4::from_slice(&node.bounds[row][half..half + 4]);
                let offset = bound - Vec4::splat(p[row % 3]);
                near = near.max(offset * Vec4::splat(self.least[row]));
                let limit = Vec4::splat(self.no_greatest[row]);
                far = far.min(offset * Vec4::splat(self.greatest[row]) + limit);
            }
            let far = (far * Vec4::splat(WIDER)).min(Vec4::splat(farthest));
            met |= near.cmple(far).bitmask() << half;
            near.write_to_slice(&mut nearest[half..half + 4]);
        }
        let first = top;
        while met != 0 {
            let k = met.trailing_zeros() as usize % WIDTH;
            met &= met - 1;
            let mut place = top;
            while place > first && pile[place - 1].1 < nearest[k] {
                pile[place] = pile[place - 1];
                place -= 1;
            }
            pile[place] = (node.children[k], nearest[k]);
            top += 1;
        }
        top
    }

    /// Intersections with a triangle, farther than `nearest` and within each ray's reach.
    #[inline(always)]
    fn meet(&self, triangle: &Triangle, nearest: f32, reach: &Eight) -> Meeting {
        let [a, b, c] = triangle.corners;
        let (a, b, c) = (sub(a, self.point), sub(b, self.point), sub(c, self.point));
        let (bc, ca, ab) = (cross(b, c), cross(c, a), cross(a, b));
        let normal = cross(sub(b, a), sub(c, a));
        let height = Vec4::splat(dot(normal, a));
        let mut met = Meeting { bits: 0, distance: [Vec4::ZERO; 2], edges: [[Vec4::ZERO; 2]; 3] };
        for half in 0..2 {
            let (u, v, w) = (self.along(bc, half), self.along(ca, half), self.along(ab, half));
            let (low, high) = (u.min(v).min(w), u.max(v).max(w));
            let inside: BVec4A = low.cmpge(Vec4::ZERO) | high.cmple(Vec4::ZERO);
            if !inside.any() {
                continue;
            }
            let t = height / self.along(normal, half);
            let hit = inside & t.cmpgt(Vec4::splat(nearest)) & t.cmplt(reach[half]);
            met.bits |= hit.bitmask() << (4 * half);
            met.distance[half] = t;
            (met.edges[0][half], met.edges[1][half], met.edges[2][half]) = (u, v, w);
        }
        met
    }

    /// Scalar products of a vector and half of the ray vectors.
    #[inline(always)]
    fn along(&self, vector: Vec3, half: usize) -> Vec4 {
        let [x, y, z] = &self.ways;
        x[half] * Vec4::splat(vector[0])
            + y[half] * Vec4::splat(vector[1])
            + z[half] * Vec4::splat(vector[2])
    }
}

#[inline(always)]
fn eight(numbers: &[f32; RAYS]) -> Eight {
    [Vec4::from_slice(&numbers[..4]), Vec4::from_slice(&numbers[4..])]
}

#[inline(always)]
fn farthest_of(reach: &[f32; RAYS]) -> f32 {
    reach.iter().fold(0.0, |a, &b| max(a, b))
}
