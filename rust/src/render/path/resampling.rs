//! Connections from primary hits to virtual lights by resampled importance sampling (Talbot, Cline
//! and Egbert 2005).
//!
//! Each quarter of a tile's pixels, one of each 2 × 2, has the virtual lights of some hundred light
//! paths as candidates. A pixel chooses one per sample, approximately in proportion to their
//! contributions, weights them by the sum over all, and traces a visibility ray to each. A path
//! sampled from the BSDF may reach the same point: the balance heuristic (Veach 1997) weights the
//! two.

use crate::render::material::{Clearcoat, Material, Surface, clearcoat_fresnel, fresnel, ggx};
use crate::render::path::PrimaryHit;
use crate::render::path::bsdf::evaluate_bsdf;
use crate::render::path::light_paths::VirtualLight;
use crate::render::path::sobol::{dimension, hash, unit};
use crate::render::path::subsurface::ray_offset;
use crate::render::path::tracer::Tracer;
use crate::render::path::virtual_lights::{Candidates, MisWeights, PATH_WEIGHT, VirtualLights};
use crate::simd::f32x64::*;
use crate::wall::packet::Hits;
use crate::wall::ray;
use crate::wall::visibility::SHADOW_REACH;
use std::f32::consts::PI;
use std::ops::Range;

/// Pixels that share candidates.
const GROUP: usize = LANES / 4;

/// A connection from a lane to a virtual light.
#[derive(Clone, Copy)]
struct Connection {
    lane: u32,
    /// Index of the virtual light among the candidates.
    source: u32,
    /// One over the expected number of times it is chosen.
    weight: f32,
}

/// Scratch memory of a tile's choices; reused between tiles.
#[derive(Default)]
pub struct Scratch {
    /// Target density of each virtual light at each receiver.
    target: Vec<[f32; GROUP]>,
    connections: Vec<Connection>,
}

/// Receivers that share candidates, and their lanes.
struct Receivers {
    lanes: [usize; GROUP],
    position: [[f32; GROUP]; 3],
    normal: [[f32; GROUP]; 3],
    face_normal: [[f32; GROUP]; 3],
    /// Base colors; 0 without a surface.
    albedo: [[f32; GROUP]; 3],
}

impl Tracer<'_> {
    /// Adds the light via virtual lights for some samples to `sums` of one tile.
    #[inline(always)]
    pub(super) fn connect_virtual_lights(
        &self,
        sources: &VirtualLights,
        (first, face_normals): (&PrimaryHit, &Lane3),
        (keys, samples): (&[u32; LANES], Range<u32>),
        (scratch, sums): (&mut Scratch, &mut [[f64; 3]]),
    ) {
        let gloss = Gloss::new(&self.transport.scene.material);
        for quarter in 0..4 {
            let receivers = Receivers::new(first, face_normals, quarter);
            let key = |lane: usize| hash(dimension(keys[lane], 6) ^ hash(samples.start));
            let candidates = sources.candidates(key(receivers.lanes[0]), self.candidate_paths);
            let numbers = receivers.lanes.map(|lane| unit(key(lane)));
            let numbers = (&numbers, samples.len());
            if gloss.is_any() {
                receivers.resample::<true>(&candidates, &gloss, numbers, scratch);
            } else {
                receivers.resample::<false>(&candidates, &gloss, numbers, scratch);
            }
            for connections in scratch.connections.chunks(LANES) {
                let light = self.unoccluded_light(&candidates, &first.surface, connections);
                let scale = samples.len() as f32 / candidates.paths as f32;
                self.trace_connections(
                    &candidates,
                    (first, face_normals),
                    connections,
                    (&light, scale, &mut *sums),
                );
            }
        }
    }

    /// Unoccluded radiance towards the viewer through up to `LANES` connections.
    #[inline(always)]
    fn unoccluded_light(
        &self,
        candidates: &Candidates<'_>,
        surface: &Surface,
        connections: &[Connection],
    ) -> Lane3 {
        let of = |i: usize| {
            let connection = connections[i.min(connections.len() - 1)];
            (connection, &candidates.sources[connection.source as usize])
        };
        let place = gathered(surface, &std::array::from_fn(|i| of(i).0.lane as usize));
        let (mut hits, mut view) = (Hits::within([0.0; LANES]), [[0.0; LANES]; 3]);
        let (mut position, mut directions) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        for i in 0..LANES {
            let source = of(i).1;
            let offset = sub(source.point, at(&place.position, i));
            let (direction, distance) = (normalize(offset), dot(offset, offset).sqrt());
            source.write_lane(
                i,
                (scale(direction, -1.0), distance),
                (&mut hits, &mut position, &mut view),
            );
            for k in 0..3 {
                directions[k][i] = direction[k];
            }
        }
        let seen = self.transport.surface(position, view, &hits);
        let mut back = [[0.0; LANES]; 3];
        for i in 0..LANES {
            for k in 0..3 {
                back[k][i] = of(i).1.back[k];
            }
        }
        let sent = evaluate_bsdf(&seen, &self.transport.scene.material, &back);
        let taken = evaluate_bsdf(&place, &self.transport.scene.material, &directions);
        let mut light = [[0.0; LANES]; 3];
        for i in 0..LANES {
            let (connection, source) = of(i);
            let square = max(hits.distance[i] * hits.distance[i], 1e-14);
            let spread = -dot(source.face_normal, at(&directions, i)) / square;
            let own = taken.pdf[i] * spread;
            let MisWeights { base, gloss } = MisWeights::new(source.density, own, candidates.paths);
            // For reflected LED light, gloss at either end counts as gloss.
            let glossy = if source.order == 1 { gloss } else { base };
            for k in 0..3 {
                let matt = base * sent.base[k][i] + glossy * sent.gloss[i];
                let shiny = gloss * (sent.base[k][i] + sent.gloss[i]);
                let value = taken.base[k][i] * matt + taken.gloss[i] * shiny;
                light[k][i] = value * source.carried[k] * spread * connection.weight;
            }
        }
        light
    }

    /// Traces the visibility rays of connections and adds the light of unoccluded ones.
    #[inline(always)]
    fn trace_connections(
        &self,
        candidates: &Candidates<'_>,
        (first, face_normals): (&PrimaryHit, &Lane3),
        connections: &[Connection],
        (light, scaled, sums): (&Lane3, f32, &mut [[f64; 3]]),
    ) {
        let clear = ray_offset(self.transport.wall);
        for (i, connection) in connections.iter().enumerate() {
            let value = scale(at(light, i), scaled);
            if max(value[0], max(value[1], value[2])) <= 0.0 {
                continue;
            }
            let (lane, source) =
                (connection.lane as usize, &candidates.sources[connection.source as usize]);
            let start = add(source.point, scale(source.face_normal, clear));
            let end = add(at(&first.surface.position, lane), scale(at(face_normals, lane), clear));
            let offset = sub(end, start);
            let reach = dot(offset, offset).sqrt() * SHADOW_REACH;
            let direction = normalize(offset);
            if ray::cast::<true>(&self.transport.wall.bvh, start, direction, reach, source.triangle)
                .is_none()
            {
                for k in 0..3 {
                    sums[lane][k] += f64::from(value[k]);
                }
            }
        }
    }
}

impl Receivers {
    /// Receivers of a quarter of a tile's lanes.
    #[inline(always)]
    fn new(first: &PrimaryHit, face_normals: &Lane3, quarter: usize) -> Self {
        let lanes = std::array::from_fn(|p| {
            let (row, column) = (p / (TILE / 2), p % (TILE / 2));
            (2 * row + quarter / 2) * TILE + 2 * column + quarter % 2
        });
        let some = |v: &Lane3| [0, 1, 2].map(|k| lanes.map(|i: usize| v[k][i]));
        let surface = &first.surface;
        let color = |k: usize| {
            lanes.map(
                |i| if first.hit[i] { surface.albedo[k][i] + VirtualLight::GLOSS } else { 0.0 },
            )
        };
        Receivers {
            lanes,
            position: some(&surface.position),
            normal: some(&surface.normal),
            face_normal: some(face_normals),
            albedo: [color(0), color(1), color(2)],
        }
    }

    /// Target density: approximate contribution of a virtual light to each receiver, unscaled.
    #[inline(always)]
    fn target<const GLOSSY: bool>(
        &self,
        source: &VirtualLight,
        gloss: &Gloss,
        near: f32,
    ) -> [f32; GROUP] {
        let mut out = [0.0; GROUP];
        let shiny = near * (PATH_WEIGHT.gloss / PATH_WEIGHT.base);
        for i in 0..GROUP {
            let get = |v: &[[f32; GROUP]; 3]| [v[0][i], v[1][i], v[2][i]];
            let (offset, albedo) = (sub(source.point, get(&self.position)), get(&self.albedo));
            let square = max(dot(offset, offset), 1e-14);
            let leaving = max(-dot(source.face_normal, offset), 0.0);
            let met = max(dot(get(&self.normal), offset), 0.0) * leaving;
            let mut value = dot(albedo, source.sent) * met / (square * square + met * near);
            if GLOSSY {
                let sent = gloss.sent(source, scale(offset, -1.0 / square.sqrt()));
                let sent = dot(albedo, source.carried) * sent;
                value += sent * met / (square * square + met * shiny);
            }
            out[i] = if dot(get(&self.face_normal), offset) > 0.0 { value } else { 0.0 };
        }
        out
    }

    /// Chooses `count` virtual lights for each receiver in proportion to the target density, by
    /// stratified sampling in their order.
    #[inline(always)]
    fn resample<const GLOSSY: bool>(
        &self,
        candidates: &Candidates<'_>,
        gloss: &Gloss,
        (numbers, count): (&[f32; GROUP], usize),
        scratch: &mut Scratch,
    ) {
        let Scratch { target, connections } = scratch;
        let mut total = [0.0; GROUP];
        target.clear();
        connections.clear();
        for source in candidates.sources {
            let each = self.target::<GLOSSY>(source, gloss, source.near / candidates.paths as f32);
            for i in 0..GROUP {
                total[i] += each[i];
            }
            target.push(each);
        }
        let step = total.map(|t| if t > 0.0 { count as f32 / t } else { 0.0 });
        let (mut sum, mut taken) = (*numbers, [0.0f32; GROUP]);
        for (source, each) in target.iter().enumerate() {
            let mut is_any = false;
            let before = sum;
            for i in 0..GROUP {
                sum[i] += each[i] * step[i];
                is_any |= sum[i] >= taken[i] + 1.0;
            }
            if !is_any {
                continue;
            }
            for i in 0..GROUP {
                if sum[i] < taken[i] + 1.0 {
                    continue;
                }
                let times = (sum[i] as u32) as f32 - taken[i];
                taken[i] += times;
                // The expected number of times, with the rounding of the sums.
                let weight = times / (sum[i] - before[i]);
                connections.push(Connection {
                    lane: self.lanes[i] as u32,
                    source: source as u32,
                    weight,
                });
            }
        }
    }
}

/// Approximate gloss of virtual lights.
struct Gloss {
    clearcoat: Clearcoat,
    /// Strength of the clearcoat.
    clearcoat_strength: f32,
    /// Reflectance of the base's gloss at normal incidence.
    straight: f32,
}

impl Gloss {
    fn new(material: &Material) -> Self {
        let straight = fresnel(1.0, material.ior);
        Gloss {
            clearcoat: Clearcoat::new(material),
            clearcoat_strength: 0.25 * material.clearcoat,
            straight,
        }
    }

    /// True if there is any gloss.
    fn is_any(&self) -> bool {
        self.clearcoat_strength > 0.0 || self.straight > 0.0
    }

    /// π times the intensity of a virtual light's gloss along a unit direction, over `carried`.
    #[inline(always)]
    fn sent(&self, source: &VirtualLight, direction: Vec3) -> f32 {
        let half = add(direction, source.back);
        let square = max(dot(half, half), 1e-6);
        let inverse = 1.0 / square.sqrt();
        let cosine = dot(source.normal, half) * inverse;
        // Half the length of the sum is the cosine between direction and half vector.
        let fresnel = clearcoat_fresnel(0.5 * square * inverse);
        let shown = max(dot(source.normal, direction), 0.5 * source.alpha);
        let base = max(self.straight, fresnel - 0.04) * ggx(cosine, source.alpha) * 0.25 / shown;
        let base = if self.straight > 0.0 { base } else { 0.0 };
        PI * (base
            + self.clearcoat_strength * fresnel * self.clearcoat.density(cosine) * source.cosine)
    }
}

/// Surface with the given lanes of another.
#[inline(always)]
fn gathered(from: &Surface, lanes: &[usize; LANES]) -> Surface {
    let some = |v: &Lane| std::array::from_fn(|i| v[lanes[i]]);
    let each = |v: &Lane3| [0, 1, 2].map(|k| some(&v[k]));
    Surface {
        position: each(&from.position),
        normal: each(&from.normal),
        view: each(&from.view),
        albedo: each(&from.albedo),
        roughness: some(&from.roughness),
    }
}
