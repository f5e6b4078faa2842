//! Light subpaths: emitted by the LEDs with equal power, extended by reflections at the wall.

use crate::render::led::Led;
use crate::render::material::Surface;
use crate::render::path::Settings;
use crate::render::path::bsdf::{self, circle, evaluate_bsdf, frame, on_circle};
use crate::render::path::sobol::{DISC_DIMENSION, dimension, point};
use crate::render::path::subsurface::ray_offset;
use crate::render::scene::SceneData;
use crate::render::shading::{attributes_at, surface};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MAX_DISTANCE, MISS};
use crate::wall::ray::{self, Hit};
use std::f32::consts::PI;

/// An LED as an emitter of light paths.
pub struct LedEmitter {
    led: Led,
    /// Fraction of the light paths.
    probability: f32,
    /// Density of directions on its axis [1/sr].
    peak: f32,
}

/// Scene, lights and settings of light transport.
pub struct LightTransport<'a> {
    /// The wall.
    pub wall: &'a Wall,
    /// Labels, textures and reflectance of the wall.
    pub scene: &'a SceneData,
    /// LEDs, relative to the wall's center.
    pub leds: &'a [Led],
    /// Angle between neighboring pixels [rad].
    pub pixel_angle: f32,
    /// Settings of path tracing.
    pub settings: Settings,
}

impl LightTransport<'_> {
    /// Surfaces hit by rays, viewed along `view`.
    #[inline(always)]
    pub fn surface(&self, position: Lane3, view: Lane3, hits: &Hits) -> Surface {
        let found = attributes_at(self.wall, self.scene, position, view, hits);
        surface(self.scene, &found, &hits.distance, self.pixel_angle)
    }
}

/// A virtual point light on the wall.
#[derive(Clone, Copy)]
pub struct VirtualLight {
    /// Position [m].
    pub point: Vec3,
    /// Triangle, in leaf order.
    pub triangle: u32,
    /// Barycentric edges as in `Hit::edges`, for a ray from the previous vertex.
    pub edges: Vec3,
    /// Unit normal of the triangle on that side.
    pub face_normal: Vec3,
    /// Unit direction to the previous vertex.
    pub back: Vec3,
    /// Power of a light path over the density of its reflection [W/sr·…]: times reflectance and
    /// cosine it is radiant intensity [W/sr].
    pub carried: Vec3,
    /// Approximate density of virtual lights per light path at this position [1/m²].
    pub density: f32,
    /// Approximately π times the radiant intensity of its base along the normal [W/sr].
    pub sent: Vec3,
    /// Unit normal with relief, roughness α of the gloss, and cosine of the incident light.
    pub normal: Vec3,
    pub alpha: f32,
    pub cosine: f32,
    /// Area [m²]: a camera path from a diffuse surface samples this point as often where cosines
    /// over squared distance equal the number of light paths over this area.
    pub near: f32,
    /// Number of reflections of its light, including the pending one.
    pub order: u32,
}

/// Vertex of a light path on the wall.
#[derive(Clone, Copy)]
pub struct LightVertex {
    number: u32,
    /// Sum of the power of its colors.
    power: f32,
    /// The virtual light at this vertex.
    pub source: VirtualLight,
}

impl VirtualLight {
    /// Added to base colors so that the choice of virtual lights includes gloss.
    pub const GLOSS: f32 = 0.03;

    /// Writes it as the hit of lane `i`: viewed along a unit direction, at a distance [m].
    #[inline(always)]
    pub fn write_lane(
        &self,
        i: usize,
        (direction, distance): (Vec3, f32),
        (hits, position, view): (&mut Hits, &mut Lane3, &mut Lane3),
    ) {
        hits.distance[i] = distance;
        hits.triangle[i] = self.triangle;
        for k in 0..3 {
            hits.edges[k][i] = self.edges[k];
            position[k][i] = self.point[k];
            view[k][i] = direction[k];
        }
    }
}

/// LEDs with nonzero power, with probabilities in proportion to it.
pub fn emitters(leds: &[Led]) -> Vec<LedEmitter> {
    let emitters = leds.iter().map(|led| {
        let peak = if led.exponent == 0.0 { 0.25 / PI } else { 0.5 * (led.exponent + 1.0) / PI };
        let [r, g, b] = led.intensity;
        LedEmitter { led: *led, probability: (r + g + b) / peak, peak }
    });
    let mut emitters: Vec<LedEmitter> =
        emitters.filter(|emitter| emitter.probability > 0.0).collect();
    let total: f32 = emitters.iter().map(|emitter| emitter.probability).sum();
    emitters.iter_mut().for_each(|emitter| emitter.probability /= total);
    emitters
}

/// Transforms a vector from the frame of a unit axis.
#[inline(always)]
fn turned(axis: Vec3, own: Vec3) -> Vec3 {
    let [right, up] = frame(axis);
    let along = add(scale(right, own[0]), scale(up, own[1]));
    normalize(add(along, scale(axis, own[2])))
}

/// Density of virtual lights that a light path creates by unoccluded direct light at a point with a
/// unit normal [1/m²].
#[inline(always)]
pub fn density(emitters: &[LedEmitter], point: Vec3, face_normal: Vec3) -> f32 {
    let mut sum = 0.0;
    for LedEmitter { led, probability, peak } in emitters {
        let offset = sub(led.position, point);
        let square = max(dot(offset, offset), 1e-12);
        let inverse = 1.0 / square.sqrt();
        let lobe = clamp(-dot(offset, led.direction) * inverse, 0.0, 1.0);
        let lobe = if led.exponent == 0.0 { 1.0 } else { pow(lobe, led.exponent) };
        sum += probability * peak * lobe * max(dot(offset, face_normal), 0.0) * inverse / square;
    }
    sum
}

/// Emits a light path from an LED to the wall.
#[inline(always)]
pub fn emit(
    emitters: &[LedEmitter],
    transport: &LightTransport<'_>,
    key: u32,
    number: u32,
) -> Option<LightVertex> {
    let [mut u, v] = point(key, number);
    let mut chosen = &emitters[0];
    for emitter in emitters {
        chosen = emitter;
        if u < emitter.probability {
            break;
        }
        u -= emitter.probability;
    }
    let LedEmitter { led, probability, peak } = chosen;
    let (cosine, sine) = circle(clamp(u / probability, 0.0, 0.999_999_9));
    let z =
        if led.exponent == 0.0 { 1.0 - 2.0 * v } else { pow(1.0 - v, 1.0 / (led.exponent + 1.0)) };
    let own = on_circle(max(1.0 - z * z, 0.0).sqrt(), z, cosine, sine);
    let direction = turned(led.direction, own);
    let start = add(led.position, led.offset(point(dimension(key, DISC_DIMENSION), number)));
    let hit = ray::cast::<false>(&transport.wall.bvh, start, direction, MAX_DISTANCE, MISS)?;
    let carried = scale(led.intensity, 1.0 / (probability * peak));
    let mut vertex = LightVertex::new(transport.wall, number, (start, direction), hit, carried)?;
    vertex.source.density = density(emitters, vertex.source.point, vertex.source.face_normal);
    Some(vertex)
}

impl LightVertex {
    /// A vertex of power `carried`; None at grazing incidence.
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
        let face_normal = if dot(normal, direction) > 0.0 { scale(normal, -1.0) } else { normal };
        let cosine = -dot(face_normal, direction);
        let source = VirtualLight {
            point: add(origin, scale(direction, hit.distance)),
            triangle: hit.triangle,
            edges: hit.edges,
            face_normal,
            back: scale(direction, -1.0),
            carried: scale(carried, 1.0 / max(cosine, 1e-6)),
            density: 2.0 * cosine,
            sent: [0.0; 3],
            normal: face_normal,
            alpha: 1.0,
            cosine,
            near: 0.0,
            order: 0,
        };
        let power = carried[0] + carried[1] + carried[2];
        (cosine > 1e-6).then_some(LightVertex { number, power, source })
    }
}

/// Extends light paths to the next point of the wall.
pub fn extend_light_paths(
    transport: &LightTransport<'_>,
    key: u32,
    light_paths: &[LightVertex],
) -> Vec<LightVertex> {
    let mut next = Vec::with_capacity(light_paths.len());
    let mut rays = [([0.0; 3], None); LANES];
    for (i, vertex) in light_paths.iter().enumerate() {
        let source = &vertex.source;
        let (direction, _) = bsdf::cosine_direction(source.face_normal, point(key, vertex.number));
        let start = add(source.point, scale(source.face_normal, ray_offset(transport.wall)));
        let hit = ray::cast::<false>(
            &transport.wall.bvh,
            start,
            direction,
            MAX_DISTANCE,
            source.triangle,
        );
        rays[i] = (direction, hit);
    }
    let reflectance = reflectance(transport, light_paths, &rays);
    for (i, LightVertex { number, power, source }) in light_paths.iter().enumerate() {
        let (direction, Some(hit)) = rays[i] else { continue };
        // The density of directions is cos/π about the face, so the cosine cancels.
        let factor = scale(at(&reflectance, i), PI);
        let carried = [0, 1, 2].map(|k| source.carried[k] * factor[k]);
        let chance = min((carried[0] + carried[1] + carried[2]) / power, 1.0);
        if point(dimension(key, 1), *number)[0] >= chance {
            continue;
        }
        let ray = (source.point, direction);
        next.extend(LightVertex::new(
            transport.wall,
            *number,
            ray,
            hit,
            scale(carried, 1.0 / chance),
        ));
    }
    next
}

/// Reflectance times cosine [1/sr] of virtual lights, for the directions in which paths continue.
fn reflectance(
    transport: &LightTransport<'_>,
    light_paths: &[LightVertex],
    rays: &[(Vec3, Option<Hit>); LANES],
) -> Lane3 {
    let seen = |i: usize| {
        let source = &light_paths[i].source;
        let (direction, hit) = rays[i];
        hit.map(|hit| (source, direction, hit.distance))
    };
    let (mut hits, mut view) = (Hits::within([0.0; LANES]), [[0.0; LANES]; 3]);
    let mut position = [[0.0; LANES]; 3];
    for i in 0..light_paths.len() {
        let Some((source, direction, distance)) = seen(i) else { continue };
        source.write_lane(i, (direction, distance), (&mut hits, &mut position, &mut view));
    }
    let surface = transport.surface(position, view, &hits);
    let mut back = [[0.0; LANES]; 3];
    for (i, vertex) in light_paths.iter().enumerate() {
        for k in 0..3 {
            back[k][i] = vertex.source.back[k];
        }
    }
    let sent = evaluate_bsdf(&surface, &transport.scene.material, &back);
    let all = |base: Lane| std::array::from_fn(|i| base[i] + sent.gloss[i]);
    sent.base.map(all)
}
