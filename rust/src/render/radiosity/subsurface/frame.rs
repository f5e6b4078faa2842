//! Light through tissue in one frame.

use super::Transport;
use crate::render::led::Led;
use crate::render::material::{Surface, add_leaving, fresnel, refract_into};
use crate::render::radiosity::lazy_cache::FrameCache;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MISS};
use crate::wall::ray;
use crate::wall::visibility::SHADOW_REACH;
use glam::Vec4;
use std::f32::consts::PI;

/// For red, green and blue at a point: the fraction of light on the point itself that exits, and
/// the exiting light that entered elsewhere [W/m²].
type Leaving = [Vec4; 2];

/// `Leaving` and the sum of all exiting light; or irradiance alone.
pub type Lit = [Vec4; 3];

/// A face visible in a tile.
#[derive(Clone, Copy)]
struct Face {
    /// In leaf order; `MISS` for none.
    triangle: u32,
    /// Radiosity of its third corner, and the differences of the first two from it.
    radiosity: [Leaving; 3],
    /// All light of LEDs and indirect light that exits, in the same form [W/m²].
    all: [Vec4; 3],
    /// Gradient of `all` along x, y and z [W/m³].
    slope: [Vec4; 3],
    /// Unit normal.
    normal: Vec3,
    /// `Tissue::drift` [m] and `Tissue::slope` for the colors around it.
    drift: Vec4,
    tilt: Vec4,
}

/// Number of faces that a tile caches.
const AT_HAND: usize = 8;

/// Light through the tissue in one frame.
pub struct SubsurfaceFrame<'a> {
    transport: &'a Transport,
    rest: &'a Wall,
    wall: &'a Wall,
    leds: Vec<Led>,
    shadows: bool,
    /// Irradiance of nodes and radiosity of vertices, computed on first use.
    known: FrameCache<'a, Lit>,
}

/// Subsurface light of a tile's surfaces.
pub struct SubsurfaceLight {
    /// Radiance towards the viewer over π and that of white diffuse, by light on the point.
    weight: Lane3,
    /// Radiance towards the viewer of light that entered elsewhere [W/(sr·m²)].
    through: Lane3,
    border: (f32, f32),
    is_wall: [bool; LANES],
}

impl Transport {
    /// Prepares one frame on the current wall.
    pub fn frame<'a>(
        &'a self,
        rest: &'a Wall,
        wall: &'a Wall,
        leds: &[Led],
        shadows: bool,
    ) -> SubsurfaceFrame<'a> {
        let (leds, known) = (leds.to_vec(), self.cache.lend());
        SubsurfaceFrame { transport: self, rest, wall, leds, shadows, known }
    }
}

impl SubsurfaceFrame<'_> {
    /// Subsurface light at surfaces; `indirect` is a vertex's irradiance without the LEDs.
    #[inline(always)]
    pub fn subsurface(
        &self,
        surface: &Surface,
        hits: &Hits,
        is_wall: [bool; LANES],
        indirect: &impl Fn(usize) -> Vec4,
    ) -> SubsurfaceLight {
        let tissue = &self.transport.tissue;
        let mut subsurface = SubsurfaceLight {
            weight: [[0.0; LANES]; 3],
            through: [[0.0; LANES]; 3],
            border: (tissue.ior, tissue.diffuse_transmittance),
            is_wall,
        };
        let mut at_hand = [Face::none(); AT_HAND];
        for i in (0..LANES).filter(|&i| is_wall[i]) {
            let triangle = hits.triangle[i];
            let face = &mut at_hand[triangle as usize % AT_HAND];
            if face.triangle != triangle {
                *face = self.face(triangle, indirect);
            }
            let [first, second, third] = &face.radiosity;
            let inverse = 1.0 / hits.edges[2][i];
            let (wa, wb) = (hits.edges[0][i] * inverse, hits.edges[1][i] * inverse);
            let [weight, light] =
                [0, 1].map(|part| third[part] + first[part] * wa + second[part] * wb);
            let (view, normal) = (at(&surface.view, i), at(&surface.normal, i));
            let inward = refract_into(view, normal, tissue.ior);
            let less = tissue.mean_cosine - dot(face.normal, inward).abs();
            let passes = tissue.transmittance(clamp(dot(normal, view), 0.0, 1.0));
            let seen = (Vec4::ONE + less * face.tilt) * face.drifted([wa, wb], inward) * passes;
            for k in 0..3 {
                let seen = seen[k] * surface.albedo[k][i];
                subsurface.weight[k][i] = seen * weight[k];
                subsurface.through[k][i] = seen * light[k] * (1.0 / PI);
            }
        }
        subsurface
    }

    fn face(&self, triangle: u32, indirect: &impl Fn(usize) -> Vec4) -> Face {
        let corners = self.wall.bvh.corners[triangle as usize];
        let [a, b, c] = corners.map(|v| self.vertex(v as usize, indirect));
        let more = |light: [Vec4; 3]| [0, 1, 2].map(|part| light[part] - c[part]);
        let (a, b) = (more(a), more(b));
        let [at_a, at_b, at_c] = self.wall.bvh.triangles[triangle as usize].corners;
        let (to_a, to_b) = (sub(at_a, at_c), sub(at_b, at_c));
        let normal = cross(to_a, to_b);
        let inverse = 1.0 / max(dot(normal, normal), 1e-30);
        let (of_a, of_b) = (cross(to_b, normal), cross(normal, to_a));
        let slope = [0, 1, 2].map(|k| (a[2] * of_a[k] + b[2] * of_b[k]) * inverse);
        let Transport { tissue, nodes, color, .. } = self.transport;
        let colors = corners.map(|v| color[nodes.of_vertex[v as usize] as usize]);
        let mean = scale(add(colors[0], add(colors[1], colors[2])), 1.0 / 3.0);
        let [drift, tilt] =
            [tissue.drift(mean), tissue.slope(mean)].map(|[r, g, b]| Vec4::new(r, g, b, 0.0));
        Face {
            triangle,
            radiosity: [a, b, c].map(|x| [x[0], x[1]]),
            all: [a, b, c].map(|x| x[2]),
            slope,
            normal: normalize(normal),
            drift,
            tilt,
        }
    }

    /// Radiosity of a vertex.
    fn vertex(&self, v: usize, indirect: &impl Fn(usize) -> Vec4) -> Lit {
        if let Some(light) = self.known.vertex(v) {
            return light;
        }
        let mut sum = [Vec4::ZERO; 3];
        let neighbors = &self.transport.nodes.neighbors[v];
        for &(node, weight) in neighbors.iter().filter(|neighbors| neighbors.1 > 0.0) {
            let radiosity = self.radiosity(node as usize, indirect);
            for part in 0..3 {
                sum[part] += weight * radiosity[part];
            }
        }
        self.known.keep_vertex(v, &sum);
        sum
    }

    /// Radiosity of a node.
    fn radiosity(&self, node: usize, indirect: &impl Fn(usize) -> Vec4) -> Lit {
        let place = self.transport.nodes.vertex.len() + node;
        if let Some(light) = self.known.gather_point(place) {
            return light;
        }
        let row = self.transport.row(self.rest, node);
        let mut light = Vec4::ZERO;
        for link in &row.far {
            let [r, g, b] = link.weight;
            light += Vec4::new(r, g, b, 0.0) * self.falling(link.from as usize, indirect);
        }
        let [near, better] = [row.near, self.transport.better(self.rest, node)]
            .map(|[r, g, b]| Vec4::new(r, g, b, 0.0));
        let (near, far) = (near * better, light * better);
        let radiosity = [near, far, near * self.falling(node, indirect) + far];
        self.known.keep_gather_point(place, &radiosity);
        radiosity
    }

    /// Irradiance of a node after transmission by the interface [W/m²].
    fn falling(&self, node: usize, indirect: &impl Fn(usize) -> Vec4) -> Vec4 {
        if let Some(light) = self.known.gather_point(node) {
            return light[0];
        }
        let vertex = self.transport.nodes.vertex[node] as usize;
        let others = indirect(vertex).max(Vec4::ZERO);
        let all = self.leds.iter().fold(others, |sum, led| sum + self.direct(vertex, led));
        self.known.keep_gather_point(node, &[all, Vec4::ZERO, Vec4::ZERO]);
        all
    }

    /// Irradiance of a vertex from an LED, as in `add_leaving`.
    fn direct(&self, vertex: usize, led: &Led) -> Vec4 {
        let offset = sub(led.position, self.wall.vertices[vertex]);
        let square = max(dot(offset, offset), 1e-12);
        let distance = square.sqrt();
        let light = scale(offset, 1.0 / distance);
        let cosine = dot(self.wall.normals[vertex], light);
        let axis = -dot(light, led.direction);
        if cosine <= 0.0 || (axis <= 0.0 && led.exponent > 0.0) {
            return Vec4::ZERO;
        }
        if self.shadows && !self.is_lit(led.position, light, distance) {
            return Vec4::ZERO;
        }
        let lobe = if led.exponent == 0.0 { 1.0 } else { pow(axis, led.exponent) };
        let tissue = &self.transport.tissue;
        let passes = (1.0 - fresnel(max(cosine, 1e-6), tissue.ior)) * cosine;
        let [r, g, b] =
            scale(led.intensity, passes * lobe / (tissue.diffuse_transmittance * square));
        Vec4::new(r, g, b, 0.0)
    }

    /// True if the segment from an LED to a point at `distance` [m] against `light` is unoccluded.
    fn is_lit(&self, origin: Vec3, light: Vec3, distance: f32) -> bool {
        let reach = distance * SHADOW_REACH;
        ray::cast::<true>(&self.wall.bvh, origin, scale(light, -1.0), reach, MISS).is_none()
    }
}

impl Face {
    fn none() -> Self {
        let zero = Vec4::ZERO;
        Face {
            triangle: MISS,
            radiosity: [[zero; 2]; 3],
            all: [zero; 3],
            slope: [zero; 3],
            normal: [0.0; 3],
            drift: zero,
            tilt: zero,
        }
    }

    /// Exiting light, at a point given by the weights of two corners, that starts along a
    /// direction, relative to light from all directions.
    #[inline(always)]
    fn drifted(&self, [wa, wb]: [f32; 2], direction: Vec3) -> Vec4 {
        let [first, second, third] = self.all;
        let here = third + first * wa + second * wb;
        let [x, y, z] = self.slope;
        let rise = x * direction[0] + y * direction[1] + z * direction[2];
        let slope = rise * self.drift / here.max(Vec4::splat(f32::MIN_POSITIVE));
        Vec4::ONE + slope.clamp(Vec4::NEG_ONE, Vec4::ONE)
    }
}

impl SubsurfaceLight {
    /// Fraction of light on the point that pixel `i` receives in color `k` through the base, and
    /// radiance of light that entered elsewhere; that of the base itself if there is no wall.
    #[inline(always)]
    pub fn of(&self, base: f32, k: usize, i: usize) -> (f32, f32) {
        if self.is_wall[i] { (self.weight[k][i], self.through[k][i]) } else { (base, 0.0) }
    }

    /// Adds the radiance that an LED's light on the point itself leaves towards the viewer.
    #[inline(always)]
    pub fn add(&self, surface: &Surface, led: &Led, visible: &Lane, radiance: &mut Lane3) {
        let mut light = [[0.0; LANES]; 3];
        add_leaving(surface, self.border, led, &mut light);
        for k in 0..3 {
            for i in 0..LANES {
                radiance[k][i] += light[k][i] * self.weight[k][i] * visible[i];
            }
        }
    }
}
