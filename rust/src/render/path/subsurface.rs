//! Subsurface scattering: random walks of light in the tissue behind the wall.
//!
//! Scattering is isotropic, by the similarity of reduced coefficients. Free paths are sampled for
//! one color, in proportion to the throughput of each, and weighted for all three by the density of
//! the mixture (Chiang, Kutz and Burley 2016; Kutz et al. 2017). The interface is the wall's own
//! triangles: light that exits elsewhere, such as on the far side of a fold, is visible there.
//! Tissue extends without limit behind the wall.

use crate::pool::detached;
use crate::render::material::fresnel;
use crate::render::path::bsdf::{circle, on_circle};
use crate::render::path::sobol::{hash, point, unit};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::MISS;
use crate::wall::ray::{self, Hit};
use numpy::{IntoPyArray, PyArray2, ndarray::Array2};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Maximum number of free paths of a walk; so few last longer that it is only a safeguard.
const MAX_FREE_PATHS: u32 = 8192;
/// Inverse of the throughput below which a walk may end early (Russian roulette); ends add noise.
const RR_SURVIVAL: f32 = 2.0;
/// Ray offset from the wall, as a fraction of the largest coordinate: larger than rounding errors.
const OFFSET: f32 = 2e-6;
/// Minimum single-scattering albedo, which bounds the coefficients.
const MIN_ALBEDO: f32 = 0.01;

/// Tissue behind a wall: its scattering, and its absorption as a function of the wall's color.
#[derive(Clone)]
pub struct Tissue {
    /// Reduced scattering coefficient for red, green and blue [1/m].
    pub scattering: Vec3,
    /// Refractive index over that of the lumen, 1 or more.
    pub ior: f32,
    /// √(1 − single-scattering albedo) for base colors from 0 to 1 in uniform steps.
    pub albedo_roots: Vec<f32>,
    /// Transmittance of the interface for diffuse light from outside.
    pub diffuse_transmittance: f32,
    /// Internal cosine at which a half-space under diffuse light has its mean radiance, and, for
    /// the base colors of `albedo_roots`, the relative rise in brightness per decrease of that
    /// cosine.
    pub mean_cosine: f32,
    /// See `mean_cosine`.
    pub angular_slopes: Vec<f32>,
}

/// Optical properties of tissue at one position.
#[derive(Clone, Copy)]
pub struct Medium {
    /// Single-scattering albedo.
    pub albedo: Vec3,
    /// Scattering and absorption coefficient [1/m].
    pub extinction: Vec3,
    /// Refractive index over that of the lumen.
    pub ior: f32,
}

impl Tissue {
    /// Tissue that reflects diffuse light with a base color.
    #[inline(always)]
    pub fn medium(&self, color: Vec3) -> Medium {
        let albedo = color.map(|c| {
            let root = between(&self.albedo_roots, c);
            max(1.0 - root * root, 0.0)
        });
        let extinction = [0, 1, 2].map(|k| self.scattering[k] / max(albedo[k], MIN_ALBEDO));
        Medium { albedo, extinction, ior: self.ior }
    }

    /// Relative excess of the light that a half-space under diffuse light sends to its interface,
    /// per cosine below `mean_cosine`.
    pub fn slope(&self, color: Vec3) -> Vec3 {
        color.map(|c| between(&self.angular_slopes, c))
    }

    /// Mean displacement, along its first direction, of the light that leaves a half-space,
    /// weighted by the exiting light [m].
    ///
    /// In free paths: 0.94 − 0.56 √(1 − albedo), fitted to walks in a half-space of index 1.4 from
    /// 20 to 45 degrees, within 7 % for albedos of 0.6 to 0.985.
    pub fn drift(&self, color: Vec3) -> Vec3 {
        [0, 1, 2].map(|k| {
            let root = between(&self.albedo_roots, color[k]);
            (0.94 - 0.56 * root) * (1.0 - root * root) / self.scattering[k]
        })
    }

    /// Transmittance of the interface at an external cosine, over that of diffuse light.
    #[inline(always)]
    pub fn transmittance(&self, cosine: f32) -> f32 {
        (1.0 - fresnel(cosine, self.ior)) / self.diffuse_transmittance
    }
}

/// Interpolates a table over 0 to 1 in uniform steps.
#[inline(always)]
fn between(table: &[f32], x: f32) -> f32 {
    let place = clamp(x, 0.0, 1.0) * (table.len() - 1) as f32;
    let first = (place as usize).min(table.len() - 2);
    table[first] + (place - first as f32) * (table[first + 1] - table[first])
}

/// A ray into or inside tissue.
#[derive(Clone, Copy)]
pub struct TissueRay {
    /// Origin [m].
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
    /// Triangle that it leaves; `MISS` for none.
    pub from: u32,
}

/// Exit of a random walk from the tissue.
pub struct SubsurfaceExit {
    /// Hit.
    pub hit: Hit,
    /// Exit point [m].
    pub point: Vec3,
    /// Unit normal of the face, away from the tissue.
    pub face_normal: Vec3,
    /// Throughput of red, green and blue.
    pub throughput: Vec3,
}

/// The interface at which tissue ends.
pub trait Interface {
    /// Offset of a path's start from the interface [m].
    fn offset(&self) -> f32;
    /// Intersection of a path within `reach` [m], and its unit normal, away from the tissue.
    fn intersect(&self, ray: &TissueRay, reach: f32) -> Option<(Hit, Vec3)>;
}

impl Interface for Wall {
    #[inline(always)]
    fn offset(&self) -> f32 {
        ray_offset(self)
    }

    #[inline(always)]
    fn intersect(
        &self,
        &TissueRay { origin, direction, from }: &TissueRay,
        reach: f32,
    ) -> Option<(Hit, Vec3)> {
        let hit = ray::cast::<false>(&self.bvh, origin, direction, reach, from)?;
        let face_normal = outward(self, &hit, direction);
        Some((hit, face_normal))
    }
}

/// An infinite plane: tissue fills a half-space.
pub struct PlaneInterface {
    /// A point on the plane [m].
    pub point: Vec3,
    /// Unit normal, away from the tissue.
    pub normal: Vec3,
    /// Offset of a path's start from the plane [m].
    pub offset: f32,
}

impl Interface for PlaneInterface {
    #[inline(always)]
    fn offset(&self) -> f32 {
        self.offset
    }

    #[inline(always)]
    fn intersect(&self, ray: &TissueRay, reach: f32) -> Option<(Hit, Vec3)> {
        let rise = dot(ray.direction, self.normal);
        let depth = dot(sub(self.point, ray.origin), self.normal);
        let distance = max(depth, 0.0) / max(rise, 1e-20);
        let hit = Hit { distance, triangle: MISS, edges: [0.0; 3], particle: MISS };
        (rise > 0.0 && distance < reach).then_some((hit, self.normal))
    }
}

/// Random numbers of one walk: the first is stratified over the walks of a key.
pub struct RandomStream {
    key: u32,
    count: u32,
    first: [f32; 4],
}

impl RandomStream {
    /// Random numbers of one of a key's walks.
    #[inline(always)]
    pub fn new(key: u32, random_walk: u32) -> Self {
        let [free, height] = point(key, random_walk);
        let [choice, turn] = point(hash(key), random_walk);
        RandomStream { key: key ^ hash(random_walk), count: 0, first: [choice, free, height, turn] }
    }

    #[inline(always)]
    fn next(&mut self) -> f32 {
        self.count += 1;
        match self.first.get(self.count as usize - 1) {
            Some(&number) => number,
            None => unit(hash(hash(self.count) ^ self.key)),
        }
    }
}

/// Distance from the wall at which rays start [m].
#[inline(always)]
pub fn ray_offset(wall: &Wall) -> f32 {
    OFFSET * wall.extent
}

/// Random walk until light leaves the tissue; None if it is absorbed.
#[inline(always)]
pub fn random_walk(
    interface: &impl Interface,
    medium: &Medium,
    mut ray: TissueRay,
    stream: &mut RandomStream,
) -> Option<SubsurfaceExit> {
    let mut throughput = [1.0f32; 3];
    for _ in 0..MAX_FREE_PATHS {
        let chances = chances(throughput, medium);
        let choice = stream.next();
        let color =
            usize::from(choice >= chances[0]) + usize::from(choice >= chances[0] + chances[1]);
        let free = -log2(1.0 - stream.next()) * std::f32::consts::LN_2 / medium.extinction[color];
        let Some((hit, face_normal)) = interface.intersect(&ray, free) else {
            ray = scatter(ray, free, stream);
            let density = medium.density(chances, free, true);
            throughput = [0, 1, 2].map(|k| throughput[k] * medium.albedo[k] * density[k]);
            let chance =
                min(max(throughput[0], max(throughput[1], throughput[2])) * RR_SURVIVAL, 1.0);
            if stream.next() >= chance {
                return None;
            }
            throughput = scale(throughput, 1.0 / chance);
            continue;
        };
        let density = medium.density(chances, hit.distance, false);
        throughput = [0, 1, 2].map(|k| throughput[k] * density[k]);
        let TissueRay { origin, direction, .. } = ray;
        let point = add(origin, scale(direction, hit.distance));
        let cosine = dot(direction, face_normal);
        if stream.next() >= fresnel_within(cosine, medium.ior) {
            return Some(SubsurfaceExit { hit, point, face_normal, throughput });
        }
        let origin = sub(point, scale(face_normal, interface.offset()));
        let direction = sub(direction, scale(face_normal, 2.0 * cosine));
        ray = TissueRay { origin, direction, from: hit.triangle };
    }
    None
}

/// Probability that each color is the one for which a free path is sampled.
#[inline(always)]
fn chances(throughput: Vec3, medium: &Medium) -> Vec3 {
    let weight = [0, 1, 2].map(|k| throughput[k] * medium.albedo[k]);
    let sum = weight[0] + weight[1] + weight[2];
    if sum > 0.0 { scale(weight, 1.0 / sum) } else { [1.0 / 3.0; 3] }
}

impl Medium {
    /// Density of a free path that ends (or lasts longer) for each color, over that of the mixture.
    #[inline(always)]
    fn density(&self, chances: Vec3, ray: f32, ends: bool) -> Vec3 {
        let own = self.extinction.map(|e| {
            let lasts = exp2(-std::f32::consts::LOG2_E * e * ray);
            if ends { e * lasts } else { lasts }
        });
        scale(own, 1.0 / max(dot(chances, own), 1e-30))
    }
}

/// A new direction, uniform over the sphere, at the end of a free path.
#[inline(always)]
fn scatter(ray: TissueRay, free: f32, stream: &mut RandomStream) -> TissueRay {
    let z = 1.0 - 2.0 * stream.next();
    let (cosine, sine) = circle(stream.next());
    TissueRay {
        origin: add(ray.origin, scale(ray.direction, free)),
        direction: on_circle(max(1.0 - z * z, 0.0).sqrt(), z, cosine, sine),
        from: MISS,
    }
}

/// Unit normal of the face hit, on the side towards which the light travels.
#[inline(always)]
fn outward(wall: &Wall, hit: &Hit, direction: Vec3) -> Vec3 {
    let [a, b, c] = wall.bvh.triangles[hit.triangle as usize].corners;
    let normal = normalize(cross(sub(b, a), sub(c, a)));
    if dot(normal, direction) < 0.0 { scale(normal, -1.0) } else { normal }
}

/// Fraction of light inside that a smooth interface reflects back.
#[inline(always)]
fn fresnel_within(cosine: f32, ior: f32) -> f32 {
    let square = 1.0 - (1.0 - cosine * cosine) * ior * ior;
    if square > 0.0 { fresnel(square.sqrt(), ior) } else { 1.0 }
}

/// Walks in the tissue behind a wall from `origin` [m] along `direction`: returns exit points [n 3]
/// (NaN if absorbed) and the throughput of red, green and blue [n 3].
///
/// `albedo` is the single-scattering albedo, `extinction` is in 1/m.
#[pyfunction]
#[pyo3(signature = (wall, origin, direction, *, albedo, extinction, ior, count, seed))]
#[allow(clippy::too_many_arguments, clippy::type_complexity)] // one keyword each
pub fn walk_tissue<'py>(
    py: Python<'py>,
    wall: &Wall,
    origin: [f64; 3],
    direction: Vec3,
    albedo: Vec3,
    extinction: Vec3,
    ior: f32,
    count: u32,
    seed: u32,
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f32>>)> {
    let is_medium = albedo.iter().all(|a| (0.0..=1.0).contains(a));
    if !(is_medium && extinction.iter().all(|&e| e > 0.0) && (1.0..3.0).contains(&ior)) {
        return Err(PyValueError::new_err(
            "Tissue needs an albedo of 0 to 1, extinction above 0 and an index of 1 to below 3.",
        ));
    }
    let medium = Medium { albedo, extinction, ior };
    let ray =
        TissueRay { origin: wall.localize(origin), direction: normalize(direction), from: MISS };
    let key = hash(seed);
    let ends: Vec<([f64; 3], Vec3)> = detached(py, || {
        let one = |number: u32| match random_walk(
            wall,
            &medium,
            ray,
            &mut RandomStream::new(key, number),
        ) {
            Some(exit) => (wall.globalize(exit.point), exit.throughput),
            None => ([f64::NAN; 3], [0.0; 3]),
        };
        (0..count).into_par_iter().with_min_len(64).map(one).collect()
    });
    let (points, throughputs): (Vec<_>, Vec<_>) = ends.into_iter().unzip();
    let rows = points.len();
    let points = Array2::from_shape_vec((rows, 3), points.into_flattened());
    let throughputs = Array2::from_shape_vec((rows, 3), throughputs.into_flattened());
    Ok((
        points.expect("three coordinates per walk").into_pyarray(py),
        throughputs.expect("three coordinates per walk").into_pyarray(py),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflectance_of_a_border_is_the_same_from_both_sides() {
        for k in 1..100 {
            let outside = k as f32 / 100.0;
            let inside = (1.0 - (1.0 - outside * outside) / (1.4 * 1.4)).sqrt();
            assert!((fresnel(outside, 1.4) - fresnel_within(inside, 1.4)).abs() < 1e-4);
        }
        assert_eq!(fresnel_within(0.69, 1.4), 1.0);
    }
}
