//! Shadow rays that start anywhere on a small disc, one to each point of a tile.
//!
//! The rays lie in a shaft between the disc and the points (Haines and Wallace 1991). A node of the
//! hierarchy is tested against the shaft's four sides, all children at once. Triangles are tested
//! against each ray by Plücker coordinates, as in `packet`: the edge functions of rays from one
//! point, and a term for the moment of each ray about that point.

use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::bvh::Triangle;
use crate::wall::packet::{Bounds, LeafVisitor, Plane, farthest_of, traverse};
use crate::wall::sides::Sides;
use crate::wall::visibility::SHADOW_REACH;
use std::ops::Range;

/// Shadow rays from a disc.
pub struct DiscRays<'a> {
    /// Center of the disc [m].
    pub center: Vec3,
    /// Radius of a sphere about the center that contains all starts [m].
    pub radius: f32,
    /// Start of each ray, relative to the center [m].
    pub starts: &'a Lane3,
    /// End of each ray [m].
    pub ends: &'a Lane3,
}

/// Ray vectors prepared for triangle tests; a distance along a ray is a fraction of its length.
struct Ways<'a> {
    center: Vec3,
    starts: &'a Lane3,
    ways: Lane3,
    /// Ray vector × start, both relative to the center.
    moments: Lane3,
    /// Distance that must be unoccluded, −1 if the ray needs no further test.
    reach: Lane,
    /// Distance of each end along the shaft [m].
    forward: Lane,
}

/// Sides of a shaft, and the plane from which distances are measured.
type Shaft = ([Plane; 4], Plane);

/// A bit for each of a tile's points whose ray is unoccluded, none in lanes not `used`; false if
/// `most` triangle tests did not suffice, in which case some bits may be set wrongly.
#[inline(always)]
pub fn visible_from_disc(
    wall: &Wall,
    rays: &DiscRays<'_>,
    used: &[bool; LANES],
    most: u32,
) -> (u64, bool) {
    let (mut ways, shaft) = prepare(wall, rays, used);
    let farthest = ways.farthest();
    let (sides, margin) = (Sides::of(&shaft.0), wall.extent * 1e-6);
    let bounds = ways.bounds(margin);
    let triangles = &wall.bvh.triangles;
    let mut search = Search { triangles, sides, bounds, margin, ways: &mut ways, left: most };
    let is_done = traverse(&wall.bvh.nodes, &shaft, farthest, &mut search);
    let mut bits = 0;
    for i in 0..LANES {
        bits |= u64::from(ways.reach[i] > 0.0) << i;
    }
    (bits, is_done)
}

/// Search for triangles that block the rays.
struct Search<'a, 'b> {
    triangles: &'a [Triangle],
    sides: Sides,
    bounds: Bounds,
    /// Margin of the bounds for rounding [m].
    margin: f32,
    ways: &'a mut Ways<'b>,
    /// Number of triangles that may still be tested.
    left: u32,
}

impl LeafVisitor for Search<'_, '_> {
    #[inline(always)]
    fn visit(&mut self, leaf: Range<usize>, farthest: f32) -> Option<f32> {
        self.left = self.left.checked_sub(leaf.len() as u32)?;
        let mut changed = false;
        for triangle in &self.triangles[leaf] {
            if !self.sides.exclude(triangle) {
                changed |= self.ways.block(triangle);
            }
        }
        if !changed {
            return Some(farthest);
        }
        self.bounds = self.ways.bounds(self.margin);
        Some(self.ways.farthest())
    }

    #[inline(always)]
    fn bounds(&self) -> Option<&Bounds> {
        Some(&self.bounds)
    }
}

/// Rays relative to the disc's center, and the shaft around them.
#[inline(always)]
fn prepare<'a>(
    wall: &Wall,
    &DiscRays { center, radius, starts, ends }: &DiscRays<'a>,
    used: &[bool; LANES],
) -> (Ways<'a>, Shaft) {
    let (mut offsets, mut sum) = ([[0.0; LANES]; 3], [0.0f32; 3]);
    for k in 0..3 {
        let mut masked = [0.0; LANES];
        for i in 0..LANES {
            offsets[k][i] = ends[k][i] - center[k];
            masked[i] = if used[i] { offsets[k][i] } else { 0.0 };
        }
        sum[k] = reduce(&masked, 0.0, |a, b| a + b);
    }
    let axis = normalize(sum);
    let mut ways = Ways {
        center,
        starts,
        ways: [[0.0; LANES]; 3],
        moments: [[0.0; LANES]; 3],
        reach: [0.0; LANES],
        forward: [0.0; LANES],
    };
    for i in 0..LANES {
        let (start, offset) = (at(starts, i), at(&offsets, i));
        let way = sub(offset, start);
        let moment = cross(way, start);
        for k in 0..3 {
            ways.ways[k][i] = way[k];
            ways.moments[k][i] = moment[k];
        }
        ways.forward[i] = dot(axis, offset);
        ways.reach[i] = if used[i] { SHADOW_REACH } else { -1.0 };
    }
    let margin = wall.extent * 1e-6;
    let shaft = shaft_around(&ways, &offsets, axis, radius, margin);
    (ways, shaft)
}

/// Reduces a lane in a fixed order, 16 values at a time, as a vector loop.
#[inline(always)]
fn reduce(lane: &Lane, start: f32, combine: impl Fn(f32, f32) -> f32) -> f32 {
    let mut partial = [start; 16];
    for row in lane.chunks_exact(16) {
        for k in 0..16 {
            partial[k] = combine(partial[k], row[k]);
        }
    }
    partial.iter().fold(start, |a, &b| combine(a, b))
}

/// Shaft from a disc to points relative to its center, whose mean direction is `axis`.
#[inline(always)]
fn shaft_around(ways: &Ways<'_>, offsets: &Lane3, axis: Vec3, radius: f32, margin: f32) -> Shaft {
    /// Minimum cosine to the axis, and minimum distance along it over the disc's radius.
    const NARROW: f32 = 0.05;
    let least = if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let right = normalize(cross(axis, least));
    let down = cross(axis, right);
    let (mut low, mut high) = ([[0.0; LANES]; 2], [[0.0; LANES]; 2]);
    let mut is_closed = true;
    for i in 0..LANES {
        let offset = at(offsets, i);
        let forward = ways.forward[i];
        let distance = dot(offset, offset).sqrt() + radius;
        let is_used = ways.reach[i] > 0.0;
        is_closed &= !is_used | (forward > NARROW * distance) & (forward > radius);
        let inverse = 1.0 / forward;
        for (k, across) in [right, down].into_iter().enumerate() {
            let slope = dot(offset, across);
            low[k][i] = if is_used { (slope + radius) * inverse } else { f32::MAX };
            high[k][i] = if is_used { (slope - radius) * inverse } else { f32::MIN };
        }
    }
    if !is_closed {
        let sides = [0; 4].map(|_| Plane::everywhere());
        return (sides, Plane::everywhere());
    }
    let least = |lane: &Lane| reduce(lane, f32::MAX, min);
    let greatest = |lane: &Lane| reduce(lane, f32::MIN, max);
    let side = |across: Vec3, slope: f32, sign: f32| {
        let normal = normalize(scale(sub(across, scale(axis, slope)), sign));
        let mut heights = [0.0; LANES];
        for i in 0..LANES {
            let end = dot(normal, at(offsets, i));
            let lowest = min(end, dot(normal, at(ways.starts, i)));
            heights[i] = if ways.reach[i] > 0.0 { lowest } else { 0.0 };
        }
        Plane::new(normal, ways.center, margin - reduce(&heights, 0.0, min), true)
    };
    let sides = [
        side(right, least(&low[0]), 1.0),
        side(right, greatest(&high[0]), -1.0),
        side(down, least(&low[1]), 1.0),
        side(down, greatest(&high[1]), -1.0),
    ];
    (sides, Plane::new(axis, ways.center, -margin, false))
}

impl Ways<'_> {
    /// Distance along the shaft of the farthest end that is still tested [m].
    #[inline(always)]
    fn farthest(&self) -> f32 {
        let mut forward = [0.0; LANES];
        for i in 0..LANES {
            forward[i] = if self.reach[i] > 0.0 { max(self.forward[i], 1e-9) } else { 0.0 };
        }
        farthest_of(&forward)
    }

    /// Bounds of the rays that are still tested.
    #[inline(always)]
    fn bounds(&self, margin: f32) -> Bounds {
        let mut bounds = [0.0; 6];
        for k in 0..3 {
            let (mut low, mut high) = ([0.0; LANES], [0.0; LANES]);
            for i in 0..LANES {
                let (start, end) = (self.starts[k][i], self.starts[k][i] + self.ways[k][i]);
                let is_tested = self.reach[i] > 0.0;
                low[i] = if is_tested { min(start, end) } else { f32::MAX };
                high[i] = if is_tested { max(start, end) } else { f32::MIN };
            }
            bounds[k] = self.center[k] + reduce(&low, f32::MAX, min) - margin;
            bounds[k + 3] = self.center[k] + reduce(&high, f32::MIN, max) + margin;
        }
        bounds
    }

    /// Ends the rays that hit a triangle; true if there are any.
    #[inline(always)]
    fn block(&mut self, triangle: &Triangle) -> bool {
        let [a, b, c] = triangle.corners.map(|corner| sub(corner, self.center));
        let (bc, ca, ab) = (cross(b, c), cross(c, a), cross(a, b));
        let (from_c, from_a, from_b) = (sub(b, c), sub(c, a), sub(a, b));
        let normal = cross(sub(b, a), sub(c, a));
        let height = dot(normal, a);
        let ([dx, dy, dz], [mx, my, mz]) = (&self.ways, &self.moments);
        let mut inside = [false; LANES];
        let mut any = false;
        for i in 0..LANES {
            let along = |n: Vec3, e: Vec3| {
                n[0] * dx[i]
                    + n[1] * dy[i]
                    + n[2] * dz[i]
                    + (e[0] * mx[i] + e[1] * my[i] + e[2] * mz[i])
            };
            let (u, v, w) = (along(bc, from_c), along(ca, from_a), along(ab, from_b));
            inside[i] = (min(u, min(v, w)) >= 0.0) | (max(u, max(v, w)) <= 0.0);
            any |= inside[i];
        }
        if !any {
            return false;
        }
        let mut changed = false;
        for i in 0..LANES {
            let way = normal[0] * dx[i] + normal[1] * dy[i] + normal[2] * dz[i];
            let start = dot(normal, at(self.starts, i));
            let t = (height - start) / way;
            let hit = inside[i] & (t > 0.0) & (t < self.reach[i]);
            self.reach[i] = if hit { -1.0 } else { self.reach[i] };
            changed |= hit;
        }
        changed
    }
}
