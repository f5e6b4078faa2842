//! Particles in a tile: surfaces that take the place of the wall in every channel.

use crate::lumen::spheres::{Near, Spheres};
use crate::mucosa::noise::Lattice;
use crate::render::material::Surface;
use crate::render::shading::Attributes;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::MISS;
use crate::wall::ray;
use crate::wall::visibility::SHADOW_REACH;
use rayon::prelude::*;

/// `Attributes::face` of particle 0; the next have smaller numbers.
const FIRST_PARTICLE: i32 = -2;
/// Roughness of particles.
const CHYME_ROUGHNESS: f32 = 0.6;
/// Size of the lumps of a particle, as a share of its radius.
const LUMPS: f32 = 0.45;

/// Place in `Contents::chyme` of the particle that each lane sees; `MISS` where there is none.
pub type Owner = [u32; LANES];

/// Puts particles of a class in the wall's place.
#[inline(always)]
pub fn write_particles(chyme: &Spheres, label: u8, owner: &Owner, found: &mut Attributes) {
    for i in (0..LANES).filter(|&i| owner[i] != MISS) {
        let sphere = &chyme.all[owner[i] as usize];
        let inverse = 1.0 / sphere.radius;
        for k in 0..3 {
            found.normal[k][i] = (found.position[k][i] - sphere.center[k]) * inverse;
        }
        found.hit[i] = true;
        found.face[i] = FIRST_PARTICLE - sphere.number as i32;
        found.weights[0][i] = 0.0;
        found.weights[1][i] = 0.0;
        found.arc_length[i] = sphere.arc_length;
        found.label[i] = label;
        found.instance[i] = sphere.instance;
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
pub fn segments_unoccluded(chyme: &Spheres, wall: &Wall, segments: &[[Vec3; 2]]) -> Vec<bool> {
    let mut free = vec![false; segments.len()];
    free.par_chunks_mut(LANES).zip(segments.par_chunks(LANES)).for_each(|(out, chunk)| {
        let mut near = Vec::new();
        for (free, &[start, point]) in out.iter_mut().zip(chunk) {
            let offset = sub(point, start);
            let (heading, reach) = (normalize(offset), dot(offset, offset).sqrt() * SHADOW_REACH);
            let (mut low, mut high) = (start, start);
            for k in 0..3 {
                low[k] = min(start[k], point[k]);
                high[k] = max(start[k], point[k]);
            }
            chyme.within((low, high), start, &mut near);
            let directions = heading.map(|x| [x; LANES]);
            let is_hidden = |near: &Near| {
                let distance = chyme.all[near.index as usize].crossings(start, &directions).near[0];
                distance > 0.0 && distance < reach
            };
            *free = reach.is_finite()
                && ray::cast::<true>(&wall.bvh, start, heading, reach, MISS).is_none()
                && !near.iter().any(is_hidden);
        }
    });
    free
}
