//! Form factors of a deformed wall, derived from those at rest.
//!
//! A form factor scales with the geometry term cos θ cos θ' A/d², and the sum of a row is conserved
//! because the lumen stays closed. Visibility is that at rest.

use super::Radiosity;
use super::gather_points::GatherPoints;
use super::lazy_cache::FrameCache;
use super::solve::CHUNK;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use rayon::prelude::*;

/// Minimum cosine: a gather point has an extent.
const LEAST_COSINE: f32 = 0.1;
/// Maximum factor by which a form factor grows or shrinks.
const MOST: f32 = 8.0;

/// Position of a gather point, as used by other points.
#[derive(Clone, Copy, Default)]
pub struct Patch {
    point: Vec3,
    normal: Vec3,
}

impl Patch {
    /// A gather point of a wall.
    #[inline(always)]
    pub fn of(wall: &Wall, gather_points: &GatherPoints, gather_point: usize) -> Self {
        let vertex = gather_points.vertex[gather_point] as usize;
        Patch { point: wall.vertices[vertex], normal: wall.normals[vertex] }
    }

    /// Exchange with another gather point per area of the latter [1/m²]; `size` is its spacing [m].
    #[inline(always)]
    pub fn geometry(&self, other: &Patch, size: f32) -> f32 {
        let offset = sub(other.point, self.point);
        let square = dot(offset, offset);
        let inverse = 1.0 / max(square, 1e-12).sqrt();
        let own = max(dot(offset, self.normal) * inverse, LEAST_COSINE);
        let its = max(-dot(offset, other.normal) * inverse, LEAST_COSINE);
        own * its / (square + size * size)
    }
}

/// A wall that is not at rest.
pub struct DeformedTransport<'a> {
    light: &'a Radiosity,
    rest: &'a Wall,
    wall: &'a Wall,
    /// Current position of gather points, on first use, and the relative area of those that emit
    /// light.
    known: FrameCache<'a, Place>,
}

/// Position of a gather point, and its area relative to that at rest, 1 if it emits no light.
pub type Place = (Patch, f32);

impl<'a> DeformedTransport<'a> {
    /// Compares a wall with itself at rest; only the gather points in `giving` emit light.
    pub fn new(light: &'a Radiosity, rest: &'a Wall, wall: &'a Wall, giving: &[u32]) -> Self {
        let deformed = DeformedTransport { light, rest, wall, known: light.places.lend() };
        giving.par_iter().with_min_len(CHUNK).for_each(|&s| {
            let vertex = light.gather_points.vertex[s as usize] as usize;
            let ratio = wall.area_around(vertex) / max(rest.area_around(vertex), 1e-30);
            let patch = Patch::of(wall, &light.gather_points, s as usize);
            deformed.known.keep_gather_point(s as usize, &(patch, ratio));
        });
        deformed
    }

    /// Current position and relative area of a gather point.
    #[inline(always)]
    fn place(&self, gather_point: usize) -> Place {
        self.known.gather_point(gather_point).unwrap_or_else(|| {
            let place = (Patch::of(self.wall, &self.light.gather_points, gather_point), 1.0);
            self.known.keep_gather_point(gather_point, &place);
            place
        })
    }

    /// Ratio of the area of a gather point to that at rest.
    pub fn area_ratio(&self, gather_point: usize) -> f32 {
        self.place(gather_point).1
    }

    /// Factors on the form factors of a row, given for each link the other gather point, the form
    /// factor and the geometry term at rest.
    #[inline(always)]
    pub fn factors(
        &self,
        gather_point: usize,
        links: impl Iterator<Item = (u32, f32, f32)>,
    ) -> impl Iterator<Item = f32> {
        let own = self.place(gather_point).0;
        let (mut before, mut after) = (0.0, 0.0);
        let mut factors = Vec::with_capacity(links.size_hint().0);
        for (from, weight, geometry) in links {
            let (place, area_ratio) = self.place(from as usize);
            let now = own.geometry(&place, self.light.gather_points.spacing[from as usize]);
            let factor = clamp(area_ratio * now / geometry, 1.0 / MOST, MOST);
            before += weight;
            after += weight * factor;
            factors.push(factor);
        }
        let whole = before / max(after, 1e-30);
        factors.into_iter().map(move |factor| factor * whole)
    }

    /// Rotates a vector at a vertex with the wall.
    #[inline(always)]
    pub fn turn(&self, vertex: usize, vector: Vec3) -> Vec3 {
        let parts = axes(self.rest, vertex).map(|axis| dot(axis, vector));
        let to = axes(self.wall, vertex);
        [0, 1, 2].map(|k| parts[0] * to[0][k] + parts[1] * to[1][k] + parts[2] * to[2][k])
    }
}

/// Unit axes fixed to the wall at a vertex: the first towards a neighbor, the last the normal.
fn axes(wall: &Wall, vertex: usize) -> [Vec3; 3] {
    let face = wall.faces[wall.faces_around(vertex)[0] as usize];
    let neighbor = face.into_iter().find(|&v| v as usize != vertex).unwrap_or(face[0]);
    let normal = wall.normals[vertex];
    let edge = sub(wall.vertices[neighbor as usize], wall.vertices[vertex]);
    let along = normalize(sub(edge, scale(normal, dot(edge, normal))));
    [along, cross(normal, along), normal]
}
