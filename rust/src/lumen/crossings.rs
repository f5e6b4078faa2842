//! Crossings of rays with bubbles; bubbles that overlap share flat walls.

use super::spheres::{Near, Sphere, Spheres};
use crate::simd::f32x64::*;

/// Distances at which the rays of a tile enter and leave a sphere [m]; −1 for rays that miss it.
pub struct Crossings {
    /// First crossing; negative if the origin is inside or beyond.
    pub near: Lane,
    /// Second crossing.
    pub far: Lane,
    /// Squared distance of the ray from the center over the squared radius; above 1 if it misses.
    pub miss: Lane,
    /// Cosine of the angle of incidence at the first crossing.
    pub cosine: Lane,
    /// Distance of the first crossing from the nearest edge over the radius: from the outline, or
    /// from the plane of a common wall.
    pub edge: Lane,
    /// True where the first or the second crossing lies in a common wall.
    pub shared: [[bool; LANES]; 2],
}

/// Flat wall that two overlapping bubbles have in common: the plane of points with equal powers,
/// which contains the circle in which their spheres intersect.
///
/// Bubbles limited by these planes are cells of a power diagram (Aurenhammer, SIAM J. Comput. 16,
/// 1987): every ray passes them in the order of their powers about its start.
struct CommonWall {
    /// Unit normal, away from the bubble.
    normal: Vec3,
    /// Distance of the plane from the bubble's center [m].
    level: f32,
}

impl Crossings {
    /// Ends the part of each ray inside a bubble at a common wall.
    #[inline(always)]
    fn cut(
        &mut self,
        sphere: &Sphere,
        wall: &CommonWall,
        start: &impl Fn(usize) -> Vec3,
        directions: &Lane3,
    ) {
        let inverse = 1.0 / sphere.radius;
        for i in 0..LANES {
            let slope = dot(at(directions, i), wall.normal);
            let height = wall.level - dot(sub(start(i), sphere.center), wall.normal);
            let limited = if slope > 0.0 { max(slope, 1e-9) } else { min(slope, -1e-9) };
            let meets = height / limited;
            let (near, far) = (self.near[i], self.far[i]);
            let (ends, begins) = ((slope > 0.0) & (meets < far), (slope <= 0.0) & (meets > near));
            let cut_near = if begins { meets } else { near };
            let cut_far = if ends { meets } else { far };
            let is_left = cut_near < cut_far;
            self.near[i] = if is_left { cut_near } else { -1.0 };
            self.far[i] = if is_left { cut_far } else { -1.0 };
            self.cosine[i] = if begins { -slope } else { self.cosine[i] };
            self.shared[0][i] |= begins;
            self.shared[1][i] |= ends;
            let apart = (height - slope * near) * inverse;
            self.edge[i] = min(self.edge[i], max(apart, 0.0));
        }
    }
}

impl Sphere {
    /// Distances of both crossings of unit rays with individual origins [m], −1 for rays that miss
    /// it, and the squared distances of the rays from the center over the squared radius.
    #[inline(always)]
    pub fn ends(&self, start: &impl Fn(usize) -> Vec3, directions: &Lane3) -> [Lane; 3] {
        let (square, inverse) = (self.radius * self.radius, 1.0 / (self.radius * self.radius));
        let mut out = [[0.0; LANES]; 3];
        for i in 0..LANES {
            let direction = at(directions, i);
            let offset = sub(self.center, start(i));
            let along = dot(offset, direction);
            // The foot of the perpendicular: exact also for a small sphere far away.
            let foot = sub(offset, scale(direction, along));
            let apart = dot(foot, foot);
            let half = max(square - apart, 0.0).sqrt();
            let hit = apart < square;
            out[0][i] = if hit { along - half } else { -1.0 };
            out[1][i] = if hit { along + half } else { -1.0 };
            out[2][i] = apart * inverse;
        }
        out
    }

    /// Common wall with another sphere; none if the surfaces do not intersect.
    #[inline(always)]
    fn common_wall(&self, other: &Sphere) -> Option<CommonWall> {
        let offset = sub(other.center, self.center);
        let square = dot(offset, offset);
        let (sum, difference) = (self.radius + other.radius, self.radius - other.radius);
        if square >= sum * sum || square <= difference * difference {
            return None;
        }
        let distance = square.sqrt();
        let level = 0.5 * (square + sum * difference) / distance;
        Some(CommonWall { normal: scale(offset, 1.0 / distance), level })
    }
}

impl Spheres {
    /// Crossings of unit rays with a bubble up to its common walls with the bubbles `near`, among
    /// which are all that the rays hit; none if all rays miss it.
    #[inline(always)]
    pub fn bubble_crossings(
        &self,
        index: u32,
        near: &[Near],
        start: impl Fn(usize) -> Vec3,
        directions: &Lane3,
    ) -> Option<Crossings> {
        let sphere = &self.all[index as usize];
        let [first, second, miss] = sphere.ends(&start, directions);
        if !second.iter().any(|&far| far > 0.0) {
            return None;
        }
        let mut crossings = Crossings {
            near: first,
            far: second,
            miss,
            cosine: miss.map(|miss| max(1.0 - miss, 0.0).sqrt()),
            edge: miss.map(|miss| 1.0 - min(miss, 1.0).sqrt()),
            shared: [[false; LANES]; 2],
        };
        for other in near.iter().filter(|other| other.index != index) {
            if let Some(wall) = sphere.common_wall(&self.all[other.index as usize]) {
                crossings.cut(sphere, &wall, &start, directions);
            }
        }
        Some(crossings)
    }
}
