//! What becomes of rows when the wall has moved: they are known at rest.
//!
//! A share grows as the exchange of light between two small areas does, cos θ cos θ' A/d², and all
//! of a row together stay as much as they were: a lumen stays closed. Who hides whom is as at rest.

use super::Radiosity;
use super::gather_points::Sites;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use rayon::prelude::*;

/// Least cosine that counts: a site is not a point.
const LEAST_COSINE: f32 = 0.1;
/// Most by which a share grows or shrinks.
const MOST: f32 = 8.0;

/// Where a site is, seen by others.
#[derive(Clone, Copy)]
pub struct Place {
    point: Vec3,
    normal: Vec3,
}

impl Place {
    /// A site of a wall.
    #[inline(always)]
    pub fn of(wall: &Wall, sites: &Sites, site: usize) -> Self {
        let vertex = sites.vertex[site] as usize;
        Place { point: wall.vertices[vertex], normal: wall.normals[vertex] }
    }

    /// Light exchanged with another site per area of it [1/m²]; `size` is its spacing [m].
    #[inline(always)]
    pub fn exchange(&self, other: &Place, size: f32) -> f32 {
        let offset = sub(other.point, self.point);
        let square = dot(offset, offset);
        let inverse = 1.0 / max(square, 1e-12).sqrt();
        let own = max(dot(offset, self.normal) * inverse, LEAST_COSINE);
        let its = max(-dot(offset, other.normal) * inverse, LEAST_COSINE);
        own * its / (square + size * size)
    }
}

/// A wall that is not at rest.
pub struct Moved<'a> {
    light: &'a Radiosity,
    rest: &'a Wall,
    /// Where each site is now, and how much larger its area is if it gives light.
    now: Vec<(Place, f32)>,
}

impl<'a> Moved<'a> {
    /// Compares a wall with itself at rest; only sites of a list give light.
    pub fn new(light: &'a Radiosity, rest: &'a Wall, wall: &Wall, giving: &[u32]) -> Self {
        let count = light.sites.vertex.len();
        let places = (0..count).into_par_iter().with_min_len(512);
        let mut now: Vec<(Place, f32)> =
            places.map(|s| (Place::of(wall, &light.sites, s), 1.0)).collect();
        for &s in giving {
            let vertex = light.sites.vertex[s as usize] as usize;
            now[s as usize].1 = wall.area_around(vertex) / max(rest.area_around(vertex), 1e-30);
        }
        Moved { light, rest, now }
    }

    /// How much larger the area of a site is than at rest.
    pub fn stretch(&self, site: usize) -> f32 {
        self.now[site].1
    }

    /// Factors of a row's shares, given who they come from, how much they are and the exchange at
    /// rest.
    #[inline(always)]
    pub fn factors(
        &self,
        site: usize,
        links: impl Iterator<Item = (u32, f32, f32)>,
    ) -> impl Iterator<Item = f32> {
        let own = self.now[site].0;
        let (mut before, mut after) = (0.0, 0.0);
        let mut factors = Vec::with_capacity(links.size_hint().0);
        for (from, share, exchange) in links {
            let (place, stretch) = &self.now[from as usize];
            let now = own.exchange(place, self.light.sites.spacing[from as usize]);
            let factor = clamp(stretch * now / exchange, 1.0 / MOST, MOST);
            before += share;
            after += share * factor;
            factors.push(factor);
        }
        let whole = before / max(after, 1e-30);
        factors.into_iter().map(move |factor| factor * whole)
    }

    /// Turns a vector at a vertex as the wall has turned there.
    #[inline(always)]
    pub fn turn(&self, wall: &Wall, vertex: usize, vector: Vec3) -> Vec3 {
        let parts = axes(self.rest, vertex).map(|axis| dot(axis, vector));
        let to = axes(wall, vertex);
        [0, 1, 2].map(|k| parts[0] * to[0][k] + parts[1] * to[1][k] + parts[2] * to[2][k])
    }
}

/// Unit axes that are fixed to the wall at a vertex: one towards a neighbour, the last its normal.
fn axes(wall: &Wall, vertex: usize) -> [Vec3; 3] {
    let face = wall.faces[wall.faces_around(vertex)[0] as usize];
    let neighbour = face.into_iter().find(|&v| v as usize != vertex).unwrap_or(face[0]);
    let normal = wall.normals[vertex];
    let edge = sub(wall.vertices[neighbour as usize], wall.vertices[vertex]);
    let along = normalize(sub(edge, scale(normal, dot(edge, normal))));
    [along, cross(normal, along), normal]
}
