//! Paths through the tissue behind the wall, a wavefront at a time.

use crate::render::led::Led;
use crate::render::material::{Surface, add_leaving, refract_into};
use crate::render::path::bsdf::{base_probability, cosine_direction};
use crate::render::path::shadow_rays::ShadowRays;
use crate::render::path::sobol::{dimension, point};
use crate::render::path::subsurface::{
    RandomStream, SubsurfaceExit, Tissue, TissueRay, random_walk, ray_offset,
};
use crate::render::path::tracer::{Path, Tracer};
use crate::simd::f32x64::*;
use crate::wall::packet::{Hits, MISS};

/// Dimension of the random numbers of walks; paths use four dimensions per reflection.
const WALK_DIMENSION: u32 = 1000;

/// A path that has entered the tissue.
pub struct SubsurfaceEntry {
    path: Path,
    /// Base color of the wall at the entry.
    color: Vec3,
}

impl Tracer<'_> {
    /// Sends some of a surface's paths into the tissue, all of them at the last reflection.
    ///
    /// Returns the probability that each stayed outside, 0 for those that have entered.
    #[inline(always)]
    pub(super) fn enter_tissue(
        &self,
        reflection: u32,
        tissue: &Tissue,
        (surface, face_normals): (&Surface, &Lane3),
        (own, used): (&[Path; LANES], &[bool; LANES]),
        entries: &mut Vec<SubsurfaceEntry>,
    ) -> Lane {
        let mut stays = [1.0; LANES];
        for i in (0..LANES).filter(|&i| used[i] && own[i].from != MISS) {
            let is_last = reflection == self.transport.settings.max_bounces;
            let chance = if is_last {
                1.0
            } else {
                base_probability(surface, &self.transport.scene.material, i)
            };
            let number = point(dimension(own[i].key, 4 * reflection + 3), own[i].sample)[0];
            if number >= chance {
                stays[i] = 1.0 - chance;
                continue;
            }
            stays[i] = 0.0;
            let (view, normal) = (at(&surface.view, i), at(&surface.normal, i));
            let mut path = own[i];
            path.direction = refract_into(view, normal, tissue.ior);
            let weight = tissue.transmittance(clamp(dot(view, normal), 0.0, 1.0)) / chance;
            path.throughput = scale(path.throughput, weight);
            let color = at(&surface.albedo, i);
            entries
                .push(SubsurfaceEntry { path: self.turn_inward(path, at(face_normals, i)), color });
        }
        stays
    }

    /// Moves a path just behind a face of unit normal `face_normal`, towards the tissue.
    #[inline(always)]
    fn turn_inward(&self, mut path: Path, face_normal: Vec3) -> Path {
        // A normal with relief may lead out through the face itself.
        let out = max(dot(path.direction, face_normal), 0.0);
        path.direction = sub(path.direction, scale(face_normal, 2.0 * out));
        path.origin = sub(path.origin, scale(face_normal, ray_offset(self.transport.wall)));
        path
    }

    /// Traces paths through the tissue, requests light at their exits, and continues them.
    #[inline(always)]
    pub(super) fn walk_tissue_paths(
        &self,
        reflection: u32,
        entries: &mut Vec<SubsurfaceEntry>,
        exits: &mut Vec<(Path, SubsurfaceExit)>,
        (paths, requests): (&mut Vec<Path>, &mut ShadowRays),
    ) {
        let Some(tissue) = &self.transport.scene.tissue else { return };
        exits.clear();
        for SubsurfaceEntry { mut path, color } in entries.drain(..) {
            let key = dimension(path.key, WALK_DIMENSION + reflection);
            let Path { origin, direction, from, .. } = path;
            let ray = TissueRay { origin, direction, from };
            let Some(exit) = random_walk(
                self.transport.wall,
                &tissue.medium(color),
                ray,
                &mut RandomStream::new(key, path.sample),
            ) else {
                continue;
            };
            path.origin = exit.point;
            path.from = exit.hit.triangle;
            path.throughput = [0, 1, 2].map(|k| path.throughput[k] * exit.throughput[k]);
            exits.push((path, exit));
        }
        for block in exits.chunks(LANES) {
            self.exit_tissue(reflection, tissue, block, (&mut *paths, &mut *requests));
        }
    }

    /// Lights up to `LANES` points where paths exit the tissue, and continues the paths.
    #[inline(always)]
    fn exit_tissue(
        &self,
        reflection: u32,
        tissue: &Tissue,
        block: &[(Path, SubsurfaceExit)],
        (paths, requests): (&mut Vec<Path>, &mut ShadowRays),
    ) {
        let own: [Path; LANES] = std::array::from_fn(|i| block[i.min(block.len() - 1)].0);
        let surface = self.exit_surfaces(block);
        let light = |led: &Led, radiance: &mut Lane3| {
            add_leaving(&surface, (tissue.ior, tissue.diffuse_transmittance), led, radiance);
        };
        self.request_led_light(reflection, &surface.position, light, &own[..block.len()], requests);
        if reflection == self.transport.settings.max_bounces {
            return;
        }
        for (i, (path, exit)) in block.iter().enumerate() {
            let mut path = *path;
            let numbers = point(dimension(path.key, 4 * reflection), path.sample);
            let (direction, cosine) = cosine_direction(at(&surface.normal, i), numbers);
            path.direction = direction;
            path.throughput = scale(path.throughput, tissue.transmittance(cosine));
            if self.survives_roulette(reflection, &mut path) {
                self.extend_path(path, exit.face_normal, paths);
            }
        }
    }

    /// Surfaces at the exits, viewed from outside along the normal.
    #[inline(always)]
    fn exit_surfaces(&self, block: &[(Path, SubsurfaceExit)]) -> Surface {
        let mut hits = Hits::within([0.0; LANES]);
        let (mut position, mut view) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        for (i, (path, exit)) in block.iter().enumerate() {
            hits.triangle[i] = exit.hit.triangle;
            for k in 0..3 {
                // Edges of a hit from the other side.
                hits.edges[k][i] = -exit.hit.edges[k];
                position[k][i] = path.origin[k];
                view[k][i] = exit.face_normal[k];
            }
        }
        self.transport.surface(position, view, &hits)
    }
}
