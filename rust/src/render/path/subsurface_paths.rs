//! Paths that go through the tissue behind the wall, a wave at a time.

use crate::render::material::{Led, Surface, add_leaving};
use crate::render::path::bsdf::{base_share, leave};
use crate::render::path::shadow_rays::Requests;
use crate::render::path::sobol::{dimension, point};
use crate::render::path::subsurface::{Exit, Stream, Tissue, Way, offset, refracted, walk};
use crate::render::path::wavefront::{Path, Tracer, Wave};
use crate::simd::f32x64::*;
use crate::wall::packet::{Hits, MISS};

/// Dimension of the random numbers of walks; those of paths are four a reflection.
const WALKS: u32 = 1000;

/// A path that has entered the tissue.
pub struct Entry {
    path: Path,
    /// Base colour of the wall there.
    color: Vec3,
}

impl Tracer<'_> {
    /// Sends some of the paths at a surface into the tissue, all of them at the last reflection.
    ///
    /// Returns the chance that each had to stay outside, 0 for those that have entered.
    #[inline(always)]
    pub(super) fn enter(
        &self,
        reflection: u32,
        tissue: &Tissue,
        (surface, facets): (&Surface, &Lane3),
        (own, used): (&[Path; LANES], &[bool; LANES]),
        entries: &mut Vec<Entry>,
    ) -> Lane {
        let mut stays = [1.0; LANES];
        for i in (0..LANES).filter(|&i| used[i] && own[i].from != MISS) {
            let is_last = reflection == self.lit.settings.depth;
            let chance =
                if is_last { 1.0 } else { base_share(surface, &self.lit.scene.material, i) };
            let number = point(dimension(own[i].key, 4 * reflection + 3), own[i].sample)[0];
            if number >= chance {
                stays[i] = 1.0 - chance;
                continue;
            }
            stays[i] = 0.0;
            let (view, normal) = (at(&surface.view, i), at(&surface.normal, i));
            let mut path = own[i];
            path.direction = refracted(view, normal, tissue.ior);
            let share = tissue.passes(clamp(dot(view, normal), 0.0, 1.0)) / chance;
            path.throughput = scale(path.throughput, share);
            let color = at(&surface.albedo, i);
            entries.push(Entry { path: self.turned_in(path, at(facets, i)), color });
        }
        stays
    }

    /// A path just behind a face of unit normal `facet`, on its way into the tissue.
    #[inline(always)]
    fn turned_in(&self, mut path: Path, facet: Vec3) -> Path {
        // Relief may lead out through the face itself.
        let out = max(dot(path.direction, facet), 0.0);
        path.direction = sub(path.direction, scale(facet, 2.0 * out));
        path.origin = sub(path.origin, scale(facet, offset(self.lit.wall)));
        path
    }

    /// Takes paths through the tissue, asks for light where they come out, and sends them on.
    #[inline(always)]
    pub(super) fn walk(&self, reflection: u32, wave: &mut Wave) {
        let Some(tissue) = &self.lit.scene.tissue else { return };
        let Wave { paths, entries, exits, requests, .. } = wave;
        exits.clear();
        for Entry { mut path, color } in entries.drain(..) {
            let key = dimension(path.key, WALKS + reflection);
            let Path { origin, direction, from, .. } = path;
            let way = Way { origin, direction, from };
            let Some(exit) =
                walk(self.lit.wall, &tissue.medium(color), way, &mut Stream::new(key, path.sample))
            else {
                continue;
            };
            path.origin = exit.point;
            path.from = exit.hit.triangle;
            path.throughput = [0, 1, 2].map(|k| path.throughput[k] * exit.share[k]);
            exits.push((path, exit));
        }
        for block in exits.chunks(LANES) {
            self.leave(reflection, tissue, block, (paths, requests));
        }
    }

    /// Lights up to `LANES` places where paths leave the tissue, and sends them on.
    #[inline(always)]
    fn leave(
        &self,
        reflection: u32,
        tissue: &Tissue,
        block: &[(Path, Exit)],
        (paths, requests): (&mut Vec<Path>, &mut Requests),
    ) {
        let own: [Path; LANES] = std::array::from_fn(|i| block[i.min(block.len() - 1)].0);
        let surface = self.left(block);
        let light = |led: &Led, radiance: &mut Lane3| {
            add_leaving(&surface, (tissue.ior, tissue.entering), led, radiance);
        };
        self.ask(reflection, &surface.position, light, &own[..block.len()], requests);
        if reflection == self.lit.settings.depth {
            return;
        }
        for (i, (path, exit)) in block.iter().enumerate() {
            let mut path = *path;
            let way = point(dimension(path.key, 4 * reflection), path.sample);
            let (direction, cosine) = leave(at(&surface.normal, i), way);
            path.direction = direction;
            path.throughput = scale(path.throughput, tissue.passes(cosine));
            if self.survives(reflection, &mut path) {
                self.go_on(path, exit.facet, paths);
            }
        }
    }

    /// Surfaces that paths leave, seen from straight outside.
    #[inline(always)]
    fn left(&self, block: &[(Path, Exit)]) -> Surface {
        let mut hits = Hits::within([0.0; LANES]);
        let (mut position, mut view) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        for (i, (path, exit)) in block.iter().enumerate() {
            hits.triangle[i] = exit.hit.triangle;
            for k in 0..3 {
                // As met from the other side.
                hits.edges[k][i] = -exit.hit.edges[k];
                position[k][i] = path.origin[k];
                view[k][i] = exit.facet[k];
            }
        }
        self.lit.surface(position, view, &hits)
    }

    /// A surface without the base that tissue stands for, if light goes through tissue.
    #[inline(always)]
    pub(super) fn bare(&self, surface: &Surface, triangles: &[u32; LANES]) -> Option<Surface> {
        self.lit.scene.tissue.as_ref().map(|_| surface.bare(triangles))
    }
}
