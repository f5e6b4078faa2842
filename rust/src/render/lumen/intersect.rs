//! Intersections of a tile's rays with wall and particles, straight or beyond a liquid's surface.

use super::particle_surfaces::Particles;
use super::refraction::Turn;
use crate::lumen::clump::Beams;
use crate::lumen::spheres::{Near, Spheres};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MAX_DISTANCE, MISS, Pyramid, farthest_of, trace_beyond};
use crate::wall::ray;

/// Rays from the camera among wall and particles.
pub struct LumenRays<'a> {
    /// The wall.
    pub wall: &'a Wall,
    /// Opaque particles.
    pub chyme: &'a Spheres,
    /// Position of the camera, relative to the wall's center [m].
    pub eye: Vec3,
}

impl LumenRays<'_> {
    /// Shortens camera rays to the particles that occlude the wall.
    #[inline(always)]
    pub fn intersect_particles(
        &self,
        rays: &Pyramid,
        hits: &mut Hits,
        near: &mut Vec<Near>,
    ) -> Particles {
        let mut met = Particles::nothing();
        let (chyme, origin) = (self.chyme, self.eye);
        let farthest = farthest_of(&hits.distance);
        chyme.gather(origin, rays, self.wall.extent, farthest, near);
        let starts = &origin.map(|x| [x; LANES]);
        let beams = Beams { starts, headings: &rays.directions, from: &[0.0; LANES] };
        chyme.meet::<false>(near, &beams, &mut hits.distance, &mut met);
        met
    }

    /// Hits of camera rays, in the lanes `used`, after reflection at a level surface. Distances are
    /// measured along the whole path.
    #[inline(always)]
    pub fn intersect_reflected(
        &self,
        mirrored: &Pyramid,
        turn: &Turn,
        used: &[bool; LANES],
        near: &mut Vec<Near>,
    ) -> (Hits, Particles) {
        let (mut hits, mut particles) = (Hits::within([0.0; LANES]), Particles::nothing());
        let mut rest = *used;
        // A tile nearly always shows one surface, rarely two.
        while let Some(first) = rest.iter().position(|&waits| waits) {
            let level = turn.place[2][first];
            let group = std::array::from_fn(|i| rest[i] & (turn.place[2][i] == level));
            let (met, theirs) =
                self.intersect_reflected_at(level, mirrored, (&turn.distance, &group), near);
            for i in (0..LANES).filter(|&i| group[i]) {
                rest[i] = false;
                hits.distance[i] = met.distance[i];
                hits.triangle[i] = met.triangle[i];
                particles.take(i, (&theirs, i));
                for k in 0..3 {
                    hits.edges[k][i] = met.edges[k][i];
                }
            }
        }
        (hits, particles)
    }

    /// Hits after reflection at one level; mirrored rays start from the mirror image of the camera.
    #[inline(always)]
    fn intersect_reflected_at(
        &self,
        level: f32,
        mirrored: &Pyramid,
        (nearest, used): (&Lane, &[bool; LANES]),
        near: &mut Vec<Near>,
    ) -> (Hits, Particles) {
        let (wall, chyme, [x, y, z]) = (self.wall, self.chyme, self.eye);
        let image = [x, y, 2.0 * level - z];
        let mut particles = Particles::nothing();
        let mut hits = Hits::within(used.map(|used| if used { MAX_DISTANCE } else { 0.0 }));
        trace_beyond::<false>(&wall.bvh, (image, nearest), mirrored, wall.extent, &mut hits);
        let farthest = farthest_of(&hits.distance);
        chyme.gather(image, mirrored, wall.extent, farthest, near);
        let starts = &image.map(|x| [x; LANES]);
        let beams = Beams { starts, headings: &mirrored.directions, from: nearest };
        chyme.meet::<false>(near, &beams, &mut hits.distance, &mut particles);
        (hits, particles)
    }

    /// Hits of rays that turn at a surface, beyond it, in the lanes `used`. Distances are measured
    /// along the whole path.
    #[inline(always)]
    pub fn intersect_refracted(
        &self,
        turn: &Turn,
        used: &[bool; LANES],
        near: &mut Vec<Near>,
    ) -> (Hits, Particles) {
        let (mut hits, mut particles) = (Hits::within([0.0; LANES]), Particles::nothing());
        let (mut around, mut pile) = (EMPTY_BOX, ray::Pile::default());
        for i in (0..LANES).filter(|&i| used[i]) {
            let (start, direction) = (at(&turn.place, i), at(&turn.heading, i));
            hits.distance[i] = MAX_DISTANCE;
            let (bvh, ray) = (&self.wall.bvh, (start, direction));
            if let Some(hit) = ray::cast_in::<false>(&mut pile, bvh, ray, MAX_DISTANCE, MISS) {
                hits.distance[i] = hit.distance;
                hits.triangle[i] = hit.triangle;
                for k in 0..3 {
                    hits.edges[k][i] = hit.edges[k];
                }
            }
            enclose(&mut around, start);
            enclose(&mut around, add(start, scale(direction, hits.distance[i])));
        }
        let chyme = self.chyme;
        chyme.within(around, around.0, near);
        let beams = Beams { starts: &turn.place, headings: &turn.heading, from: &[0.0; LANES] };
        chyme.meet::<false>(near, &beams, &mut hits.distance, &mut particles);
        for i in (0..LANES).filter(|&i| used[i]) {
            hits.distance[i] += turn.distance[i];
        }
        (hits, particles)
    }
}
