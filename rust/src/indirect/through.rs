//! Light through the tissue behind the wall, in real time: what sites gain or lose by it.
//!
//! Where light that falls on a site comes out is known from walks at rest. In a frame the LEDs'
//! light is summed over those places; what it is more or less than the light at the site itself is
//! added to the irradiance there. Detail finer than sites, such as relief, stays as it is.

use super::lobe::Lobe;
use super::sites::{Sites, nearest_corner};
use crate::lanes::*;
use crate::material::Led;
use crate::path::random::{hash, point};
use crate::path::ray;
use crate::path::walk::{Exit, Stream, Tissue, Way, border, offset, plane, refracted, walk};
use crate::wall::Wall;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Walks of a site are a square of so many by so many.
const SIDE: usize = 12;
/// How far above the wall ways to the LEDs start, as a share of the largest coordinate.
const LIFT: f32 = 1e-4;
/// Most of what comes out, over that of a half-space.
const MOST: f32 = 2.0;
/// Least share that comes out by which places are told apart.
const LEAST: f32 = 1e-6;

/// Where light that enters at a site comes out: a vertex, and its share of red, green and blue.
type Passage = (u32, Vec3);

/// What becomes of light that enters around a site.
struct Row {
    /// Where it comes out, as far as sites tell it apart.
    passages: Box<[Passage]>,
    /// What comes out at the site itself. All together are what comes out over what comes out of a
    /// half-space of the same tissue.
    own: Vec3,
}

/// Light through the tissue behind a wall at rest.
pub struct Through {
    tissue: Tissue,
    rows: Vec<OnceLock<Row>>,
}

/// The LEDs of one frame.
pub struct Lamps<'a> {
    through: &'a Through,
    wall: &'a Wall,
    leds: Vec<Led>,
    /// Their mean place, from which shadows fall, if things cast any.
    middle: Option<Vec3>,
    /// Irradiance of vertices that passes the border.
    entering: Vec<Entering>,
}

/// Irradiance of a vertex, reckoned when first needed: a number whose bits are all zero is not yet
/// known, a zero that is known is negative. Threads that need it at once all reckon the same.
#[derive(Default)]
struct Entering([AtomicU32; 3]);

impl Entering {
    #[inline(always)]
    fn get(&self, reckon: impl FnOnce() -> Vec3) -> Vec3 {
        let known = [0, 1, 2].map(|k: usize| self.0[k].load(Relaxed));
        if known.iter().all(|&bits| bits != 0) {
            return known.map(f32::from_bits);
        }
        let found = reckon().map(|x| if x == 0.0 { -0.0 } else { x });
        for (slot, x) in self.0.iter().zip(found) {
            slot.store(x.to_bits(), Relaxed);
        }
        found
    }
}

impl Through {
    /// Nothing walked yet.
    pub fn new(tissue: &Tissue, num_sites: usize) -> Self {
        let rows = (0..num_sites).map(|_| OnceLock::new()).collect();
        Through { tissue: tissue.clone(), rows }
    }

    /// The LEDs on a wall as it is.
    pub fn lit<'a>(&'a self, wall: &'a Wall, leds: &[Led], shadows: bool) -> Lamps<'a> {
        let sum = leds.iter().fold([0.0; 3], |sum, led| add(sum, led.position));
        let middle = shadows.then(|| scale(sum, 1.0 / leds.len().max(1) as f32));
        let entering = (0..wall.vertices.len()).map(|_| Entering::default()).collect();
        Lamps { through: self, wall, leds: leds.to_vec(), middle, entering }
    }
}

/// Walks from the faces around a site of a wall at rest, and beside each the same walk behind a
/// plane: how far the two differ is known better than either.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn walk_row(rest: &Wall, sites: &Sites, tissue: &Tissue, (site, color): (usize, Vec3)) -> Row {
    let vertex = sites.vertex[site] as usize;
    let (medium, behind, key) = (tissue.medium(color), offset(rest), hash(site as u32));
    let around = rest.faces_around(vertex);
    let (mut total, mut level, mut far) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    let mut passages: Vec<Passage> = Vec::with_capacity(SIDE * SIDE);
    for number in 0..SIDE * SIDE {
        let face = rest.faces[around[number % around.len()] as usize];
        let (place, normal) = somewhere(rest, face, point(hash(!key), number as u32));
        let view = Lobe::turned(normal, 1.0, SIDE, site).direction(number / SIDE, number % SIDE);
        let passes = tissue.passes(dot(view, normal)) / (SIDE * SIDE) as f32;
        let origin = sub(place, scale(normal, 2.0 * behind));
        let way = Way { origin, direction: refracted(view, normal, tissue.ior), from: u32::MAX };
        let stream = || Stream::new(key, number as u32);
        let share = |exit: &Exit| scale(exit.share, passes);
        let flat = walk(plane(place, normal), behind, &medium, way, &mut stream());
        level = flat.map_or(level, |exit| add(level, share(&exit)));
        if let Some(exit) = walk(border(rest), behind, &medium, way, &mut stream()) {
            total = add(total, share(&exit));
            let apart = sub(exit.point, place);
            far = add(far, scale(share(&exit), dot(apart, apart)));
            let corner = nearest_corner(rest, exit.hit.triangle, exit.hit.edges);
            passages.push((corner as u32, share(&exit)));
        }
    }
    passages.sort_by_key(|passage| passage.0);
    let square = sites.spacing[site] * sites.spacing[site];
    let each = |f: &dyn Fn(usize) -> f32| [0, 1, 2].map(f);
    let whole = each(&|k| clamp(1.0 + (total[k] - level[k]) / max(color[k], LEAST), 0.0, MOST));
    // Light that stays within a site's own patch is not told apart from that of the site.
    let known = each(&|k| far[k] / max(far[k] + square * total[k], 1e-30));
    let factor = each(&|k| whole[k] * known[k] / max(total[k], LEAST));
    let merged = passages.chunk_by(|a, b| a.0 == b.0).map(|run| {
        let sum = run.iter().fold([0.0; 3], |sum, passage| add(sum, passage.1));
        (run[0].0, each(&|k| sum[k] * factor[k]))
    });
    let passages: Box<[Passage]> = merged.collect();
    let away = passages.iter().fold([0.0; 3], |sum, passage| add(sum, passage.1));
    Row { own: sub(whole, away), passages }
}

/// A point of a face and the face's unit normal.
#[inline(always)]
fn somewhere(wall: &Wall, face: [u32; 3], [u, v]: [f32; 2]) -> (Vec3, Vec3) {
    let [a, b, c] = face.map(|v| wall.vertices[v as usize]);
    let (ab, ac) = (sub(b, a), sub(c, a));
    let root = u.sqrt();
    let place = add(a, add(scale(ab, root * (1.0 - v)), scale(ac, root * v)));
    (place, normalize(cross(ab, ac)))
}

impl Lamps<'_> {
    /// Irradiance [W/m²] that light through tissue adds at a site of a mean colour, or takes away.
    pub fn gained(&self, rest: &Wall, sites: &Sites, (site, color): (usize, Vec3)) -> Vec3 {
        let Through { tissue, rows } = self.through;
        let row = rows[site].get_or_init(|| walk_row(rest, sites, tissue, (site, color)));
        let vertex = sites.vertex[site];
        let (plain, own) = (self.falls_on(vertex, |_| 1.0), self.entering(vertex));
        let mut gained = [0, 1, 2].map(|k| row.own[k] * own[k] - plain[k]);
        for &(from, share) in &row.passages {
            let light = self.entering(from);
            for k in 0..3 {
                gained[k] += share[k] * light[k];
            }
        }
        gained
    }

    /// Irradiance of a vertex that passes the border, over the mean share of even light.
    #[inline(always)]
    fn entering(&self, vertex: u32) -> Vec3 {
        let passes = |cosine| self.through.tissue.passes(cosine);
        self.entering[vertex as usize].get(|| self.falls_on(vertex, passes))
    }

    /// Irradiance of a vertex [W/m²], weighted by a function of the cosine.
    #[inline(always)]
    fn falls_on(&self, vertex: u32, weight: impl Fn(f32) -> f32) -> Vec3 {
        let v = vertex as usize;
        let (place, normal) = (self.wall.vertices[v], self.wall.normals[v]);
        let mut light = [0.0; 3];
        for led in &self.leds {
            let offset = sub(led.position, place);
            let square = max(dot(offset, offset), 1e-12);
            let way = scale(offset, 1.0 / square.sqrt());
            let cosine = min(dot(normal, way), 1.0);
            let axis = clamp(-dot(way, led.direction), 0.0, 1.0);
            if cosine > 0.0 {
                let lobe = if led.exponent == 0.0 { 1.0 } else { pow(axis, led.exponent) };
                let power = lobe * cosine * weight(cosine) / square;
                light = add(light, scale(led.intensity, power));
            }
        }
        if light != [0.0; 3] && self.is_dark(place, normal) { [0.0; 3] } else { light }
    }

    /// Whether something is between a place and the middle of the LEDs, if things cast shadows.
    #[inline(always)]
    fn is_dark(&self, place: Vec3, normal: Vec3) -> bool {
        let Some(middle) = self.middle else { return false };
        let start = add(place, scale(normal, LIFT * self.wall.extent));
        let way = sub(middle, start);
        let reach = dot(way, way).sqrt();
        ray::cast::<true>(&self.wall.bvh, start, normalize(way), reach, u32::MAX).is_some()
    }
}
