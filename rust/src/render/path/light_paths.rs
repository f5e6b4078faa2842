//! Light paths: they leave the LEDs with equal power and go on as the wall reflects them.

use crate::render::frame::REACH;
use crate::render::material::{Led, Surface};
use crate::render::path::Settings;
use crate::render::path::bsdf::{self, circle, frame, on_circle, towards};
use crate::render::path::sobol::{dimension, point};
use crate::render::path::subsurface::offset;
use crate::render::path::virtual_lights::Source;
use crate::render::scene::SceneData;
use crate::render::shading::{attributes_at, surface};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MISS};
use crate::wall::ray::{self, Hit};
use std::f32::consts::PI;

/// What of an LED its light paths go by.
pub struct Lamp {
    led: Led,
    /// Share of the light paths.
    share: f32,
    /// Density of directions on its axis [1/sr].
    peak: f32,
}

/// What paths travel in.
pub struct Lit<'a> {
    /// The wall.
    pub wall: &'a Wall,
    /// What is drawn on it.
    pub scene: &'a SceneData,
    /// LEDs about the wall's centre.
    pub leds: &'a [Led],
    /// Angle between neighbouring pixels [rad].
    pub pixel_angle: f32,
    /// How paths are traced.
    pub settings: Settings,
}

impl Lit<'_> {
    /// Surfaces that rays have met, seen from where `view` points.
    #[inline(always)]
    pub fn surface(&self, position: Lane3, view: Lane3, hits: &Hits) -> Surface {
        let found = attributes_at(self.wall, self.scene, position, view, hits);
        surface(self.scene, &found, &hits.distance, self.pixel_angle)
    }
}

/// A light path that has come to the wall.
#[derive(Clone, Copy)]
pub struct Arrival {
    number: u32,
    /// Sum of its colours' power.
    power: f32,
    /// What it leaves there.
    pub source: Source,
}

/// LEDs that shine, with shares in proportion to their power.
pub fn lamps(leds: &[Led]) -> Vec<Lamp> {
    let lamps = leds.iter().map(|led| {
        let peak = if led.exponent == 0.0 { 0.25 / PI } else { 0.5 * (led.exponent + 1.0) / PI };
        let [r, g, b] = led.intensity;
        Lamp { led: *led, share: (r + g + b) / peak, peak }
    });
    let mut lamps: Vec<Lamp> = lamps.filter(|lamp| lamp.share > 0.0).collect();
    let total: f32 = lamps.iter().map(|lamp| lamp.share).sum();
    lamps.iter_mut().for_each(|lamp| lamp.share /= total);
    lamps
}

/// A vector given about a unit axis.
#[inline(always)]
fn turned(axis: Vec3, own: Vec3) -> Vec3 {
    let [right, up] = frame(axis);
    let along = add(scale(right, own[0]), scale(up, own[1]));
    normalize(add(along, scale(axis, own[2])))
}

/// Sources of the LEDs' own light that a light path leaves at a place, by its unit normal, were
/// nothing in the way [1/m²].
#[inline(always)]
pub fn density(lamps: &[Lamp], point: Vec3, facet: Vec3) -> f32 {
    let mut sum = 0.0;
    for Lamp { led, share, peak } in lamps {
        let offset = sub(led.position, point);
        let square = max(dot(offset, offset), 1e-12);
        let inverse = 1.0 / square.sqrt();
        let lobe = clamp(-dot(offset, led.direction) * inverse, 0.0, 1.0);
        let lobe = if led.exponent == 0.0 { 1.0 } else { pow(lobe, led.exponent) };
        sum += share * peak * lobe * max(dot(offset, facet), 0.0) * inverse / square;
    }
    sum
}

/// Sends a light path from an LED to the wall.
#[inline(always)]
pub fn leave(lamps: &[Lamp], lit: &Lit<'_>, key: u32, number: u32) -> Option<Arrival> {
    let [mut u, v] = point(key, number);
    let mut chosen = &lamps[0];
    for lamp in lamps {
        chosen = lamp;
        if u < lamp.share {
            break;
        }
        u -= lamp.share;
    }
    let Lamp { led, share, peak } = chosen;
    let (cosine, sine) = circle(clamp(u / share, 0.0, 0.999_999_9));
    let z =
        if led.exponent == 0.0 { 1.0 - 2.0 * v } else { pow(1.0 - v, 1.0 / (led.exponent + 1.0)) };
    let own = on_circle(max(1.0 - z * z, 0.0).sqrt(), z, cosine, sine);
    let direction = turned(led.direction, own);
    let hit = ray::cast::<false>(&lit.wall.bvh, led.position, direction, REACH, MISS)?;
    let carried = scale(led.intensity, 1.0 / (share * peak));
    let mut arrival = Arrival::new(lit.wall, number, (led.position, direction), hit, carried)?;
    arrival.source.density = density(lamps, arrival.source.point, arrival.source.facet);
    Some(arrival)
}

impl Arrival {
    /// Of power `carried`; None where the light comes along the wall.
    #[inline(always)]
    fn new(
        wall: &Wall,
        number: u32,
        (origin, direction): (Vec3, Vec3),
        hit: Hit,
        carried: Vec3,
    ) -> Option<Self> {
        let [a, b, c] = wall.bvh.triangles[hit.triangle as usize].corners;
        let normal = normalize(cross(sub(b, a), sub(c, a)));
        let facet = if dot(normal, direction) > 0.0 { scale(normal, -1.0) } else { normal };
        let cosine = -dot(facet, direction);
        let source = Source {
            point: add(origin, scale(direction, hit.distance)),
            triangle: hit.triangle,
            edges: hit.edges,
            facet,
            back: scale(direction, -1.0),
            carried: scale(carried, 1.0 / max(cosine, 1e-6)),
            density: 2.0 * cosine,
            sent: [0.0; 3],
            normal: facet,
            alpha: 1.0,
            cosine,
            near: 0.0,
            order: 0,
        };
        let power = carried[0] + carried[1] + carried[2];
        (cosine > 1e-6).then_some(Arrival { number, power, source })
    }
}

/// Takes light paths to the next place of the wall.
pub fn go_on(lit: &Lit<'_>, key: u32, on_way: &[Arrival]) -> Vec<Arrival> {
    let mut next = Vec::with_capacity(on_way.len());
    let mut ways = [([0.0; 3], None); LANES];
    for (i, arrival) in on_way.iter().enumerate() {
        let source = &arrival.source;
        let (direction, _) = bsdf::leave(source.facet, point(key, arrival.number));
        let start = add(source.point, scale(source.facet, offset(lit.wall)));
        let hit = ray::cast::<false>(&lit.wall.bvh, start, direction, REACH, source.triangle);
        ways[i] = (direction, hit);
    }
    let reflected = reflected(lit, on_way, &ways);
    for (i, Arrival { number, power, source }) in on_way.iter().enumerate() {
        let (direction, Some(hit)) = ways[i] else { continue };
        // The density of directions is cos/π about the face: the cosine cancels.
        let share = scale(at(&reflected, i), PI);
        let carried = [0, 1, 2].map(|k| source.carried[k] * share[k]);
        let chance = min((carried[0] + carried[1] + carried[2]) / power, 1.0);
        if point(dimension(key, 1), *number)[0] >= chance {
            continue;
        }
        let way = (source.point, direction);
        next.extend(Arrival::new(lit.wall, *number, way, hit, scale(carried, 1.0 / chance)));
    }
    next
}

/// Reflectance times cosine [1/sr] of sources, seen from where paths go.
fn reflected(lit: &Lit<'_>, on_way: &[Arrival], ways: &[(Vec3, Option<Hit>); LANES]) -> Lane3 {
    let seen = |i: usize| {
        let source = &on_way[i].source;
        let (direction, hit) = ways[i];
        hit.map(|hit| (source, direction, hit.distance))
    };
    let (mut hits, mut view) = (Hits::within([0.0; LANES]), [[0.0; LANES]; 3]);
    let mut position = [[0.0; LANES]; 3];
    for i in 0..on_way.len() {
        let Some((source, direction, distance)) = seen(i) else { continue };
        source.put(i, (direction, distance), (&mut hits, &mut position, &mut view));
    }
    let surface = lit.surface(position, view, &hits);
    let mut back = [[0.0; LANES]; 3];
    for (i, arrival) in on_way.iter().enumerate() {
        for k in 0..3 {
            back[k][i] = arrival.source.back[k];
        }
    }
    let sent = towards(&surface, &lit.scene.material, &back);
    let all = |base: Lane| std::array::from_fn(|i| base[i] + sent.gloss[i]);
    sent.base.map(all)
}
