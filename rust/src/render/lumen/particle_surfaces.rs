//! Particles in a tile: surfaces that replace the wall in every channel.

use crate::lumen::clump::Met;
use crate::lumen::spheres::Spheres;
use crate::mucosa::noise::Lattice;
use crate::render::material::Surface;
use crate::render::shading::Attributes;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::MISS;
use crate::wall::ray;
use crate::wall::visibility::SHADOW_REACH;
use rayon::prelude::*;

/// `Attributes::face` of particle 0; the next have lower indices.
const FIRST_PARTICLE: i32 = -2;
/// Roughness of particles.
const CHYME_ROUGHNESS: f32 = 0.6;

/// Random lumps of one size, which tilt the normal and modulate the color.
#[derive(Clone, Copy)]
struct Octave {
    /// Size [m].
    size: f32,
    /// Change of the normal.
    tilt: f32,
    /// Relative change of the color.
    contrast: f32,
}

/// Crumbs and grain of a clump.
const GRAIN: [Octave; 3] = [
    Octave { size: 0.9e-3, tilt: 0.2, contrast: 0.25 },
    Octave { size: 0.4e-3, tilt: 0.35, contrast: 0.3 },
    Octave { size: 0.18e-3, tilt: 0.3, contrast: 0.25 },
];

/// Lumps of a single particle.
fn lumps(radius: f32) -> [Octave; 2] {
    [
        Octave { size: 0.45 * radius, tilt: 0.4, contrast: 0.25 },
        Octave { size: 0.225 * radius, tilt: 0.25, contrast: 0.2 },
    ]
}

/// Hits of a tile's rays on the particles of `Contents::chyme`.
pub type Particles = Met<LANES>;

/// Replaces the wall by particles of a class.
#[inline(always)]
pub fn write_particles(chyme: &Spheres, label: u8, met: &Particles, found: &mut Attributes) {
    for i in (0..LANES).filter(|&i| met.owner[i] != MISS) {
        let sphere = &chyme.all[met.owner[i] as usize];
        for k in 0..3 {
            found.normal[k][i] = met.normal[k][i];
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

/// Sets color and lumps of particles.
#[inline(always)]
pub fn paint(chyme: &Spheres, met: &Particles, surface: &mut Surface) {
    for i in (0..LANES).filter(|&i| met.owner[i] != MISS) {
        let sphere = &chyme.all[met.owner[i] as usize];
        let lumps = lumps(sphere.radius);
        let grain: &[Octave] = if sphere.is_alone() { &lumps } else { &GRAIN };
        let seeds = [sphere.number, !sphere.number, sphere.number ^ 0x5555_5555];
        let own = sub(at(&surface.position, i), sphere.center);
        let (mut rough, mut shade) = (at(&surface.normal, i), 1.0);
        for (k, &Octave { size, tilt, contrast }) in grain.iter().enumerate() {
            let noise = Lattice::new(seeds[k], size).displacement(own);
            rough = add(rough, scale(noise, tilt));
            shade += contrast * noise[k];
        }
        // Lumps that face away from the viewer are invisible.
        let away = min(dot(rough, at(&surface.view, i)) - 0.05, 0.0);
        let normal = normalize(sub(rough, scale(at(&surface.view, i), away)));
        for k in 0..3 {
            surface.normal[k][i] = normal[k];
            surface.albedo[k][i] = clamp(met.color[k][i] * shade, 0.0, 0.95);
        }
        surface.roughness[i] = CHYME_ROUGHNESS;
    }
}

/// `true` for segments that neither wall nor particles occlude; the last bit of each is ignored.
pub fn segments_unoccluded(chyme: &Spheres, wall: &Wall, segments: &[[Vec3; 2]]) -> Vec<bool> {
    let mut free = vec![false; segments.len()];
    free.par_chunks_mut(LANES).zip(segments.par_chunks(LANES)).for_each(|(out, chunk)| {
        let mut near = Vec::new();
        for (free, &[start, point]) in out.iter_mut().zip(chunk) {
            let offset = sub(point, start);
            let (heading, reach) = (normalize(offset), dot(offset, offset).sqrt() * SHADOW_REACH);
            let mut around = (start, start);
            enclose(&mut around, point);
            // Particles last: the march through a clump is the slowest test.
            *free = reach.is_finite()
                && ray::cast::<true>(&wall.bvh, start, heading, reach, MISS).is_none()
                && {
                    chyme.within(around, start, &mut near);
                    chyme.meet_ray::<true>(&mut near, (start, heading), reach).0 == reach
                };
        }
    });
    free
}
