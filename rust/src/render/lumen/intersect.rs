//! Intersections of a tile's rays with wall and particles, straight and beyond a liquid's surface.

use super::particle_surfaces::Owner;
use super::refraction::Turn;
use crate::lumen::spheres::{Crossings, Near, Spheres};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MAX_DISTANCE, MISS, Pyramid, farthest_of, trace_beyond};
use crate::wall::ray;

/// Rays from an eye among wall and particles.
pub struct LumenRays<'a> {
    /// The wall.
    pub wall: &'a Wall,
    /// Opaque particles.
    pub chyme: &'a Spheres,
    /// The eye, about the wall's center [m].
    pub eye: Vec3,
}

impl LumenRays<'_> {
    /// Shortens rays from the eye to the particles that hide the wall.
    #[inline(always)]
    pub fn intersect_particles(
        &self,
        rays: &Pyramid,
        hits: &mut Hits,
        near: &mut Vec<Near>,
    ) -> Owner {
        let mut owner = [MISS; LANES];
        let (chyme, origin) = (self.chyme, self.eye);
        let farthest = farthest_of(&hits.distance);
        chyme.gather(origin, rays, self.wall.extent, farthest, near);
        for &Near { index, .. } in near.iter() {
            let sphere = &chyme.all[index as usize];
            let crossings = sphere.crossings(origin, &rays.directions);
            shorten(&crossings, index, &[0.0; LANES], hits, &mut owner);
        }
        owner
    }

    /// What rays from the eye meet, in the lanes `used`, after a level surface has mirrored them.
    /// Distances count along the whole way.
    #[inline(always)]
    pub fn intersect_reflected(
        &self,
        mirrored: &Pyramid,
        turn: &Turn,
        used: &[bool; LANES],
        near: &mut Vec<Near>,
    ) -> (Hits, Owner) {
        let (mut hits, mut owner) = (Hits::within([0.0; LANES]), [MISS; LANES]);
        let mut rest = *used;
        // A tile sees one surface, hardly ever two.
        while let Some(first) = rest.iter().position(|&waits| waits) {
            let level = turn.place[2][first];
            let group = std::array::from_fn(|i| rest[i] & (turn.place[2][i] == level));
            let (met, theirs) =
                self.intersect_reflected_at(level, mirrored, (&turn.distance, &group), near);
            for i in (0..LANES).filter(|&i| group[i]) {
                rest[i] = false;
                hits.distance[i] = met.distance[i];
                hits.triangle[i] = met.triangle[i];
                owner[i] = theirs[i];
                for k in 0..3 {
                    hits.edges[k][i] = met.edges[k][i];
                }
            }
        }
        (hits, owner)
    }

    /// The same for one level: mirrored rays come straight from where the eye's image in it is.
    #[inline(always)]
    fn intersect_reflected_at(
        &self,
        level: f32,
        mirrored: &Pyramid,
        (nearest, used): (&Lane, &[bool; LANES]),
        near: &mut Vec<Near>,
    ) -> (Hits, Owner) {
        let (wall, chyme, [x, y, z]) = (self.wall, self.chyme, self.eye);
        let image = [x, y, 2.0 * level - z];
        let mut owner = [MISS; LANES];
        let mut hits = Hits::within(used.map(|used| if used { MAX_DISTANCE } else { 0.0 }));
        trace_beyond::<false>(&wall.bvh, (image, nearest), mirrored, wall.extent, &mut hits);
        let farthest = farthest_of(&hits.distance);
        chyme.gather(image, mirrored, wall.extent, farthest, near);
        for &Near { index, .. } in near.iter() {
            let sphere = &chyme.all[index as usize];
            let crossings = sphere.crossings(image, &mirrored.directions);
            shorten(&crossings, index, nearest, &mut hits, &mut owner);
        }
        (hits, owner)
    }

    /// What rays that turn at a surface meet beyond it, in the lanes `used`. Distances count along the
    /// whole way.
    #[inline(always)]
    pub fn intersect_refracted(
        &self,
        turn: &Turn,
        used: &[bool; LANES],
        near: &mut Vec<Near>,
    ) -> (Hits, Owner) {
        let (mut hits, mut owner) = (Hits::within([0.0; LANES]), [MISS; LANES]);
        let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
        for i in (0..LANES).filter(|&i| used[i]) {
            let (start, direction) = (at(&turn.place, i), at(&turn.heading, i));
            hits.distance[i] = MAX_DISTANCE;
            if let Some(hit) =
                ray::cast::<false>(&self.wall.bvh, start, direction, MAX_DISTANCE, MISS)
            {
                hits.distance[i] = hit.distance;
                hits.triangle[i] = hit.triangle;
                for k in 0..3 {
                    hits.edges[k][i] = hit.edges[k];
                }
            }
            let end = add(start, scale(direction, hits.distance[i]));
            for k in 0..3 {
                low[k] = min(low[k], min(start[k], end[k]));
                high[k] = max(high[k], max(start[k], end[k]));
            }
        }
        let chyme = self.chyme;
        chyme.within((low, high), low, near);
        for &Near { index, .. } in near.iter() {
            let sphere = &chyme.all[index as usize];
            let crossings = sphere.crossings_from(|i| at(&turn.place, i), &turn.heading);
            shorten(&crossings, index, &[0.0; LANES], &mut hits, &mut owner);
        }
        for i in (0..LANES).filter(|&i| used[i]) {
            hits.distance[i] += turn.distance[i];
        }
        (hits, owner)
    }
}

/// Ends at a sphere the rays that meet it first, beyond `nearest` [m].
#[inline(always)]
fn shorten(crossings: &Crossings, index: u32, nearest: &Lane, hits: &mut Hits, owner: &mut Owner) {
    for i in 0..LANES {
        let nearer = (crossings.near[i] > nearest[i]) & (crossings.near[i] < hits.distance[i]);
        hits.distance[i] = if nearer { crossings.near[i] } else { hits.distance[i] };
        owner[i] = if nearer { index } else { owner[i] };
    }
}
