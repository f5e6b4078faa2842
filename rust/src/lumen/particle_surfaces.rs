//! Particles in a tile: surfaces that take the place of the wall in every channel.

use super::refraction::Turn;
use super::spheres::{Crossings, Near, Spheres};
use super::tile::{Filled, Room};
use crate::mucosa::noise::Lattice;
use crate::render::material::Surface;
use crate::render::shading::Attributes;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MAX_DISTANCE, MISS, Pyramid, farthest_of, trace_beyond};
use crate::wall::ray;
use crate::wall::visibility::FREE_WAY;
use rayon::prelude::*;

/// `Attributes::face` of particle 0; the next have smaller numbers.
const FIRST_PARTICLE: i32 = -2;
/// Roughness of particles.
const CHYME_ROUGHNESS: f32 = 0.6;
/// Size of the lumps of a particle, as a share of its radius.
const LUMPS: f32 = 0.45;

/// Place in `Contents::chyme` of the particle that each lane sees; `MISS` where there is none.
pub type Owner = [u32; LANES];

impl Filled<'_> {
    /// Shortens rays from the eye to the particles that hide the wall.
    #[inline(always)]
    pub fn meet_particles(&self, rays: &Pyramid, hits: &mut Hits, room: &mut Room) -> Owner {
        let mut owner = [MISS; LANES];
        let (chyme, origin) = (&self.contents.chyme, self.view.origin);
        let farthest = farthest_of(&hits.distance);
        chyme.gather(origin, rays, self.wall.extent, farthest, &mut room.near);
        for near in &room.near {
            let sphere = &chyme.all[near.index as usize];
            let ways = sphere.crossings(origin, &rays.directions);
            shorten(&ways, near, &[0.0; LANES], hits, &mut owner);
        }
        owner
    }

    /// What rays from the eye meet, in the lanes `used`, after a level surface has mirrored them.
    /// Distances count along the whole way.
    #[inline(always)]
    pub fn meet_mirrored(
        &self,
        mirrored: &Pyramid,
        turn: &Turn,
        used: &[bool; LANES],
        room: &mut Room,
    ) -> (Hits, Owner) {
        let (mut hits, mut owner) = (Hits::within([0.0; LANES]), [MISS; LANES]);
        let mut rest = *used;
        // A tile sees one surface, hardly ever two.
        while let Some(first) = rest.iter().position(|&waits| waits) {
            let level = turn.place[2][first];
            let group = std::array::from_fn(|i| rest[i] & (turn.place[2][i] == level));
            let (met, theirs) = self.meet_image(level, mirrored, (&turn.way, &group), room);
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
    fn meet_image(
        &self,
        level: f32,
        mirrored: &Pyramid,
        (nearest, used): (&Lane, &[bool; LANES]),
        room: &mut Room,
    ) -> (Hits, Owner) {
        let (wall, chyme, [x, y, z]) = (self.wall, &self.contents.chyme, self.view.origin);
        let image = [x, y, 2.0 * level - z];
        let mut owner = [MISS; LANES];
        let mut hits = Hits::within(used.map(|used| if used { MAX_DISTANCE } else { 0.0 }));
        trace_beyond::<false>(&wall.bvh, (image, nearest), mirrored, wall.extent, &mut hits);
        let farthest = farthest_of(&hits.distance);
        chyme.gather(image, mirrored, wall.extent, farthest, &mut room.near);
        for near in &room.near {
            let sphere = &chyme.all[near.index as usize];
            let ways = sphere.crossings(image, &mirrored.directions);
            shorten(&ways, near, nearest, &mut hits, &mut owner);
        }
        (hits, owner)
    }

    /// What rays that turn at a surface meet beyond it, in the lanes `used`. Distances count along the
    /// whole way.
    #[inline(always)]
    pub fn meet(&self, turn: &Turn, used: &[bool; LANES], room: &mut Room) -> (Hits, Owner) {
        let (mut hits, mut owner) = (Hits::within([0.0; LANES]), [MISS; LANES]);
        let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
        for i in (0..LANES).filter(|&i| used[i]) {
            let (start, way) = (at(&turn.place, i), at(&turn.heading, i));
            hits.distance[i] = MAX_DISTANCE;
            if let Some(hit) = ray::cast::<false>(&self.wall.bvh, start, way, MAX_DISTANCE, MISS) {
                hits.distance[i] = hit.distance;
                hits.triangle[i] = hit.triangle;
                for k in 0..3 {
                    hits.edges[k][i] = hit.edges[k];
                }
            }
            let end = add(start, scale(way, hits.distance[i]));
            for k in 0..3 {
                low[k] = min(low[k], min(start[k], end[k]));
                high[k] = max(high[k], max(start[k], end[k]));
            }
        }
        let chyme = &self.contents.chyme;
        chyme.within((low, high), low, &mut room.near);
        for near in &room.near {
            let sphere = &chyme.all[near.index as usize];
            let ways = sphere.crossings_from(|i| at(&turn.place, i), &turn.heading);
            shorten(&ways, near, &[0.0; LANES], &mut hits, &mut owner);
        }
        for i in (0..LANES).filter(|&i| used[i]) {
            hits.distance[i] += turn.way[i];
        }
        (hits, owner)
    }

    /// Puts particles in the wall's place.
    #[inline(always)]
    pub fn put_particles(&self, owner: &Owner, found: &mut Attributes) {
        for i in (0..LANES).filter(|&i| owner[i] != MISS) {
            let sphere = &self.contents.chyme.all[owner[i] as usize];
            let inverse = 1.0 / sphere.radius;
            for k in 0..3 {
                found.normal[k][i] = (found.position[k][i] - sphere.center[k]) * inverse;
            }
            found.hit[i] = true;
            found.face[i] = FIRST_PARTICLE - sphere.number as i32;
            found.weights[0][i] = 0.0;
            found.weights[1][i] = 0.0;
            found.arc_length[i] = sphere.arc_length;
            found.label[i] = self.contents.label;
            found.instance[i] = sphere.instance;
        }
    }
}

/// Gives particles their color and their lumps.
#[inline(always)]
pub fn paint(chyme: &Spheres, owner: &Owner, surface: &mut Surface) {
    for i in (0..LANES).filter(|&i| owner[i] != MISS) {
        let sphere = &chyme.all[owner[i] as usize];
        let size = LUMPS * sphere.radius;
        let own = sub(at(&surface.position, i), sphere.center);
        let lump = Lattice::new(sphere.number, size).displacement(own);
        let grain = Lattice::new(!sphere.number, 0.5 * size).displacement(own);
        let smooth = at(&surface.normal, i);
        let rough = [0, 1, 2].map(|k| smooth[k] + 0.4 * lump[k] + 0.25 * grain[k]);
        // Lumps that turn away from the viewer are not seen.
        let away = min(dot(rough, at(&surface.view, i)) - 0.05, 0.0);
        let normal = normalize(sub(rough, scale(at(&surface.view, i), away)));
        let shade = 1.0 + 0.25 * lump[0] + 0.2 * grain[1];
        for k in 0..3 {
            surface.normal[k][i] = normal[k];
            surface.albedo[k][i] = clamp(sphere.color[k] * shade, 0.0, 0.95);
        }
        surface.roughness[i] = CHYME_ROUGHNESS;
    }
}

/// Whether wall and particles leave straight ways free; the last trifle of each does not count.
pub fn segments_unoccluded(chyme: &Spheres, wall: &Wall, ways: &[[Vec3; 2]]) -> Vec<bool> {
    let mut free = vec![false; ways.len()];
    free.par_chunks_mut(LANES).zip(ways.par_chunks(LANES)).for_each(|(out, chunk)| {
        let mut near = Vec::new();
        for (free, &[start, point]) in out.iter_mut().zip(chunk) {
            let offset = sub(point, start);
            let (heading, reach) = (normalize(offset), dot(offset, offset).sqrt() * FREE_WAY);
            let (mut low, mut high) = (start, start);
            for k in 0..3 {
                low[k] = min(start[k], point[k]);
                high[k] = max(start[k], point[k]);
            }
            chyme.within((low, high), start, &mut near);
            let directions = heading.map(|x| [x; LANES]);
            let is_hidden = |near: &Near| {
                let way = chyme.all[near.index as usize].crossings(start, &directions).near[0];
                way > 0.0 && way < reach
            };
            *free = reach.is_finite()
                && ray::cast::<true>(&wall.bvh, start, heading, reach, MISS).is_none()
                && !near.iter().any(is_hidden);
        }
    });
    free
}

/// Ends at a sphere the rays that meet it first, beyond `nearest` [m].
#[inline(always)]
fn shorten(ways: &Crossings, near: &Near, nearest: &Lane, hits: &mut Hits, owner: &mut Owner) {
    for i in 0..LANES {
        let nearer = (ways.near[i] > nearest[i]) & (ways.near[i] < hits.distance[i]);
        hits.distance[i] = if nearer { ways.near[i] } else { hits.distance[i] };
        owner[i] = if nearer { near.index } else { owner[i] };
    }
}
