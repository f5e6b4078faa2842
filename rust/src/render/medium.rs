//! Turbid fluid between the capsule and the wall: extinction of the wall's light, backscattered
//! light of the LEDs, and the fraction of light that reaches the camera unscattered.
//!
//! All are integrated along some 40 rays across the image (Wronski 2014, SIGGRAPH course
//! "Volumetric fog": a grid in the frustum) and interpolated at the distance of the wall in each
//! pixel. Extinction coefficients are those of transport, `absorption + (1 − g) scattering`: light
//! that is scattered forward stays in the beam. Orders of scattering beyond the first have the
//! attenuation to the power 1/2, 1/4, … (Wrenninge, Kulla and Lundqvist 2013, "Oz: the great and
//! volumetric") and weights that give a half-space its true brightness (see `render/medium.py`).

use crate::pool::on_pool;
use crate::simd::f32x64::{Vec3, dot, sub};
use numpy::{IntoPyArray, PyArray2, PyArray3, ndarray};
use numpy::{PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Approximate number of integrated rays across the image; some 4 degrees apart in a wide view.
const RAYS: usize = 40;
/// Number of intervals along a ray; they grow with distance.
const SLICES: usize = 16;
/// Number of orders of scattering; the last represents all higher orders.
const ORDERS: usize = 5;
/// Number of octaves of the noise.
const OCTAVES: u32 = 3;
/// Scale of three octaves of gradient noise, which gives a standard deviation of 0.69.
const SCALE: f32 = 0.322;
/// Scale of one octave for the same deviation.
const OCTAVE_SCALE: f32 = 0.264;
/// Rotation from one octave to the next, by 1 rad about (1, 2, 3): aligned lattices show blocks.
const TURN: [Vec3; 3] = [
    [0.573_137_9, -0.609_006_6, 0.548_291_8],
    [0.740_348_8, 0.671_644_5, -0.027_879_3],
    [-0.351_278_5, 0.421_905_9, 0.835_822_3],
];
/// Maximum distance from which light returns [m].
const FARTHEST: f32 = 0.1;

/// Extinction by flocs averaged over space, relative to that inside them.
const MEAN_FLOCS: f32 = 0.016;

/// Values of a node of the grid: backscattered light [3], transmittance of the camera's path [3]
/// and of the LEDs' paths [3], and optical depth of scattering.
const VALUES: usize = 10;
type Node = [f32; VALUES];

/// The fluid in one view.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Medium {
    /// Absorption of red, green and blue at mean density [1/m].
    absorption: Vec3,
    /// Absorption by dissolved bile, the same everywhere [1/m].
    stain: Vec3,
    /// Scattering coefficient at mean density [1/m].
    scattering: Vec3,
    /// Mean cosine of the scattering angle.
    anisotropy: f32,
    /// Weight of each order of scattering relative to the one before, by color.
    orders: Vec3,
    /// Factor of the noise in the logarithm of density, and size of the largest clouds [m].
    clouds: (f32, f32),
    /// Extinction inside flocs [1/m], and their size [m].
    flocs: (f32, f32),
    /// Fraction of its extinction that a floc scatters.
    floc_color: Vec3,
    seed: u32,
}

/// Camera and LEDs in the frame of the camera.
struct Rig<'a> {
    size: (usize, usize),
    rays: &'a [f32],
    start: &'a [f32],
    leds: Vec<[f32; 10]>,
    pose: [f32; 12],
    farthest: f32,
}

/// Attenuates the wall's light in planes [3 h w], in place.
///
/// Returns the light that the medium scatters to the camera [3 h w] and the unscattered fraction of
/// the wall's light [h w]. Rays [h w 3] are NaN outside the camera's field of view, distances [h w]
/// where a ray hits no wall.
#[pyfunction]
#[pyo3(signature = (planes, rays, distance, start, pose, leds, medium))]
#[allow(clippy::type_complexity, clippy::too_many_arguments)] // called from Python only
pub fn immerse<'py>(
    py: Python<'py>,
    mut planes: PyReadwriteArray3<'py, f32>,
    rays: PyReadonlyArray3<'py, f32>,
    distance: PyReadonlyArray2<'py, f32>,
    start: PyReadonlyArray2<'py, f32>,
    pose: PyReadonlyArray2<'py, f64>,
    leds: PyReadonlyArray2<'py, f64>,
    medium: Medium,
) -> PyResult<(Bound<'py, PyArray3<f32>>, Bound<'py, PyArray2<f32>>)> {
    let [height, width] = distance.shape()[..] else { unreachable!("two dimensions") };
    let fits = rays.shape() == [height, width, 3] && start.shape() == [height, width];
    if !(fits && planes.shape() == [3, height, width]) || pose.shape() != [4, 4] {
        return Err(PyValueError::new_err("Planes, rays, distance and start must be of one size."));
    }
    if leds.shape()[1] != 11 || height * width == 0 {
        return Err(PyValueError::new_err("LEDs must be of shape (k, 11)."));
    }
    let (distance, pose, rows) = (distance.as_slice()?, pose.as_array(), leds.as_array());
    let finite = distance.iter().filter(|x| x.is_finite()).fold(0.0f32, |a, &b| a.max(b));
    let rig = Rig {
        size: (height, width),
        rays: rays.as_slice()?,
        start: start.as_slice()?,
        leds: rows.outer_iter().map(|row| std::array::from_fn(|k| row[k] as f32)).collect(),
        pose: std::array::from_fn(|k| pose[[k / 4, k % 4]] as f32),
        farthest: if finite > 0.0 { finite.min(FARTHEST) } else { FARTHEST },
    };
    let area = height * width;
    let mut veil = vec![0.0; 3 * area];
    let mut clear = vec![1.0; area];
    let mut image = planes.as_array_mut();
    on_pool(py, || {
        let grid = Grid::new(&rig, &medium);
        let mut lines: Vec<_> = image.axis_iter_mut(ndarray::Axis(1)).collect();
        let (red, rest) = veil.split_at_mut(area);
        let (green, blue) = rest.split_at_mut(area);
        let veils = red
            .par_chunks_mut(width)
            .zip(green.par_chunks_mut(width))
            .zip(blue.par_chunks_mut(width));
        lines.par_iter_mut().zip(veils).zip(clear.par_chunks_mut(width)).enumerate().for_each(
            |(y, ((line, ((red, green), blue)), clear))| {
                let out = Line { image: line, veil: [red, green, blue], clear };
                immerse_line(&grid, &rig, y, &distance[y * width..][..width], out);
            },
        );
    });
    let shape = "the sizes match";
    let veil = ndarray::Array3::from_shape_vec((3, height, width), veil).expect(shape);
    let clear = ndarray::Array2::from_shape_vec((height, width), clear).expect(shape);
    Ok((veil.into_pyarray(py), clear.into_pyarray(py)))
}

/// A line of an image, of the light scattered to the camera by color, and of the unscattered
/// fraction of the wall's light.
struct Line<'a, 'b> {
    image: &'a mut ndarray::ArrayViewMut2<'b, f32>,
    veil: [&'a mut [f32]; 3],
    clear: &'a mut [f32],
}

/// Attenuates the light of the wall at some distances [w] in line `y` of an image.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn immerse_line(grid: &Grid, rig: &Rig<'_>, y: usize, distance: &[f32], out: Line<'_, '_>) {
    let Line { image, veil, clear } = out;
    for (x, &distance) in distance.iter().enumerate() {
        let Some(node) = grid.at(rig, (y, x), distance) else { continue };
        for k in 0..3 {
            veil[k][x] = node[k];
            image[[k, x]] *= node[3 + k] * node[6 + k];
        }
        clear[x] = (-node[9]).exp();
    }
}

/// Integrals along the rays of every few pixels, at the ends of all intervals.
struct Grid {
    /// Pixels between rays.
    step: usize,
    columns: usize,
    /// None outside the camera's field of view.
    rays: Vec<Option<Box<[Node; SLICES + 1]>>>,
}

impl Grid {
    fn new(rig: &Rig<'_>, medium: &Medium) -> Self {
        let (height, width) = rig.size;
        let step = height.max(width).div_ceil(RAYS);
        let (rows, columns) = (height.div_ceil(step) + 1, width.div_ceil(step) + 1);
        let cell = rig.angle(step);
        let rays = (0..rows * columns).into_par_iter().map(|k| {
            let (y, x) =
                ((k / columns * step).min(height - 1), (k % columns * step).min(width - 1));
            rig.ray(y * width + x).map(|(ray, start)| medium.integrate(rig, (ray, start), cell))
        });
        Grid { step, columns, rays: rays.collect() }
    }

    /// Values at a distance along the ray of a pixel; None if no node near it is known.
    #[inline(always)]
    fn at(&self, rig: &Rig<'_>, (y, x): (usize, usize), distance: f32) -> Option<Node> {
        let (_, start) = rig.ray(y * rig.size.1 + x)?;
        let distance = if distance.is_finite() { distance } else { FARTHEST };
        let along = ((distance - start) / (rig.farthest - start).max(1e-6)).clamp(0.0, 1.0);
        let along = along.sqrt() * SLICES as f32;
        let slice = (along as usize).min(SLICES - 1);
        let t = along - slice as f32;
        let (mut sum, mut whole) = ([0.0; VALUES], 0.0);
        for (row, v) in spline(y, self.step, self.rays.len() / self.columns) {
            for (column, u) in spline(x, self.step, self.columns) {
                let weight = u * v;
                let Some(ray) = &self.rays[row * self.columns + column] else { continue };
                for k in 0..VALUES {
                    sum[k] += weight * (ray[slice][k] + t * (ray[slice + 1][k] - ray[slice][k]));
                }
                whole += weight;
            }
        }
        (whole > 0.0).then(|| sum.map(|x| x / whole))
    }
}

/// Nodes around a pixel and their weights, of the quadratic B-spline: linear weights would show
/// flocs as blocks.
#[inline(always)]
fn spline(pixel: usize, step: usize, count: usize) -> [(usize, f32); 3] {
    let at = pixel as f32 / step as f32;
    let middle = at.round();
    let t = at - middle;
    let weights = [0.5 * (0.5 - t) * (0.5 - t), 0.75 - t * t, 0.5 * (0.5 + t) * (0.5 + t)];
    std::array::from_fn(|k| ((middle as usize + k).clamp(1, count) - 1, weights[k]))
}

impl Rig<'_> {
    /// Direction of a pixel's ray and the distance at which it leaves the capsule [m].
    #[inline(always)]
    fn ray(&self, pixel: usize) -> Option<(Vec3, f32)> {
        let ray = [0, 1, 2].map(|k| self.rays[3 * pixel + k]);
        ray.iter().all(|x| x.is_finite()).then(|| (ray, self.start[pixel]))
    }

    /// Angle between rays some pixels apart in the middle of the image [rad]; 0 if it is narrower.
    fn angle(&self, step: usize) -> f32 {
        let (height, width) = self.size;
        let middle = height / 2 * width + width / 2;
        let next = middle + step.min(width - 1 - width / 2);
        let apart = self.ray(middle).zip(self.ray(next)).map(|(one, other)| sub(one.0, other.0));
        apart.map_or(0.0, |apart| dot(apart, apart).sqrt())
    }

    /// A point in the frame to which the clouds are fixed [m].
    fn fixed(&self, point: Vec3) -> Vec3 {
        [0, 4, 8].map(|k| {
            self.pose[k] * point[0]
                + self.pose[k + 1] * point[1]
                + self.pose[k + 2] * point[2]
                + self.pose[k + 3]
        })
    }
}

impl Medium {
    /// Integrals along a ray from the distance at which it leaves the capsule, given the angle to
    /// the next ray.
    fn integrate(
        &self,
        rig: &Rig<'_>,
        (ray, start): (Vec3, f32),
        cell: f32,
    ) -> Box<[Node; SLICES + 1]> {
        let mut out = Box::new([[0.0; VALUES]; SLICES + 1]);
        // Optical depths: of transport by color, and of scattering.
        let (mut depth, mut scattered, mut veil) = ([0.0f32; 3], 0.0f32, [0.0f32; 3]);
        let length = (rig.farthest - start).max(1e-6);
        let node = |at: f32, depth: &Vec3, scattered: f32, veil: &Vec3| -> Node {
            let (lit, all) = self.arriving(rig, ray.map(|x| x * at), (start, at), depth);
            let mut node = [0.0; VALUES];
            for k in 0..3 {
                node[k] = veil[k];
                node[3 + k] = (-depth[k]).exp();
                node[6 + k] = if all[k] > 0.0 { lit[k] / all[k] } else { (-depth[k]).exp() };
            }
            node[9] = scattered;
            node
        };
        out[0] = node(start, &depth, 0.0, &veil);
        let mut from = start;
        for slice in 0..SLICES {
            let part = (slice + 1) as f32 / SLICES as f32;
            let to = start + length * part * part;
            let (step, middle) = (to - from, 0.5 * (from + to));
            let (density, flocs) = self.density(rig.fixed(ray.map(|x| x * middle)), cell * middle);
            let back: Vec3 = std::array::from_fn(|k| {
                density * (1.0 - self.anisotropy) * self.scattering[k] + flocs * self.floc_color[k]
            });
            let gone: Vec3 = std::array::from_fn(|k| {
                let lost = self.absorption[k] + (1.0 - self.anisotropy) * self.scattering[k];
                density * lost + flocs + self.stain[k]
            });
            let halfway: Vec3 = std::array::from_fn(|k| depth[k] + 0.5 * step * gone[k]);
            let light = self.scattered(rig, ray.map(|x| x * middle), (start, middle), &halfway);
            for k in 0..3 {
                veil[k] += step * back[k] * light[k];
                depth[k] += step * gone[k];
            }
            scattered += step * density * self.anisotropy * self.scattering[1];
            out[slice + 1] = node(to, &depth, scattered, &veil);
            from = to;
        }
        out
    }

    /// Irradiance at a point at a distance along a ray, with and without extinction on the path
    /// from the LEDs; their mean extinction is taken from the ray.
    fn arriving(
        &self,
        rig: &Rig<'_>,
        point: Vec3,
        (start, at): (f32, f32),
        depth: &Vec3,
    ) -> (Vec3, Vec3) {
        let (mut lit, mut all) = ([0.0; 3], [0.0; 3]);
        for led in &rig.leds {
            let (arrives, way) = irradiance(led, point);
            let ratio = (way - start).max(0.0) / (at - start).max(1e-6);
            for k in 0..3 {
                all[k] += arrives[k];
                lit[k] += arrives[k] * (-depth[k] * ratio).exp();
            }
        }
        (lit, all)
    }

    /// Radiance per scattering coefficient that a point on a ray sends to the camera, after
    /// extinction on both paths, summed over all orders of scattering.
    fn scattered(&self, rig: &Rig<'_>, point: Vec3, (start, at): (f32, f32), depth: &Vec3) -> Vec3 {
        let mut sum = [0.0; 3];
        for led in &rig.leds {
            let (arrives, way) = irradiance(led, point);
            let ratio = (way - start).max(0.0) / (at - start).max(1e-6);
            for k in 0..3 {
                let mut transmitted = (-depth[k] * (1.0 + ratio)).exp();
                let (mut weight, mut orders) = (1.0, 0.0);
                for order in 0..ORDERS {
                    let last = order + 1 == ORDERS;
                    orders += transmitted * weight / if last { 1.0 - self.orders[k] } else { 1.0 };
                    transmitted = transmitted.sqrt();
                    weight *= 0.5 * self.orders[k];
                }
                sum[k] += arrives[k] * orders / (4.0 * PI);
            }
        }
        sum
    }

    /// Density relative to the mean, and extinction by flocs [1/m], given the distance to the next
    /// ray [m]. Flocs fade to their mean where they are less than four rays apart, which would show
    /// them as blocks.
    fn density(&self, point: Vec3, apart: f32) -> (f32, f32) {
        let (spread, size) = self.clouds;
        let mut density = 1.0;
        if spread > 0.0 {
            // Wisps: the clouds are elongated along one direction.
            let at = [point[0], point[1] + 0.5 * point[2], 0.4 * point[2]].map(|x| x / size);
            let noise = fractal(at, self.seed);
            density = (spread * noise - 0.5 * spread * spread).exp();
        }
        let (extinction, size) = self.flocs;
        let mut flocs = 0.0;
        if extinction > 0.0 {
            let at = TURN.map(|row| dot(row, point.map(|x| x / size)));
            let noise = gradient_noise(at, self.seed ^ 0x9e37_79b9) / OCTAVE_SCALE;
            let t = ((noise - 1.2) / 0.6).clamp(0.0, 1.0);
            let resolved = (0.5 * size / apart.max(1e-9) - 1.0).clamp(0.0, 1.0);
            let floc = t * t * (3.0 - 2.0 * t);
            flocs = extinction * (MEAN_FLOCS + resolved * (floc - MEAN_FLOCS));
        }
        (density, flocs)
    }
}

/// Irradiance of a surface that faces an LED, and the distance from it [m].
fn irradiance(led: &[f32; 10], point: Vec3) -> (Vec3, f32) {
    let way = sub(point, [led[0], led[1], led[2]]);
    let square = dot(way, way).max(1e-8);
    let length = square.sqrt();
    let cosine = dot(way, [led[3], led[4], led[5]]) / length;
    let lobe = match led[9] {
        0.0 => 1.0,
        1.0 => cosine.max(0.0),
        exponent => libm::powf(cosine.max(0.0), exponent),
    };
    ([6, 7, 8].map(|k| led[k] * lobe / square), length)
}

/// Sum of octaves of noise, of mean 0 and standard deviation 0.69.
fn fractal(point: Vec3, seed: u32) -> f32 {
    let (mut sum, mut at, mut height) = (0.0, point, 1.0);
    for octave in 0..OCTAVES {
        at = TURN.map(|row| dot(row, at));
        sum += height * gradient_noise(at, seed.wrapping_add(octave.wrapping_mul(0x632b_e5ab)));
        at = at.map(|x| 2.1 * x);
        height *= 0.6;
    }
    sum / SCALE
}

/// Gradient noise: 0 at integer points, with gradients of components from −1 to 1 (Perlin 1985).
fn gradient_noise(point: Vec3, seed: u32) -> f32 {
    let cell = point.map(f32::floor);
    let offset = sub(point, cell);
    let t = offset.map(|x| x * x * (3.0 - 2.0 * x));
    let corner = cell.map(|x| x as i32);
    let at = |dx: i32, dy: i32, dz: i32| {
        let slope = gradient([corner[0] + dx, corner[1] + dy, corner[2] + dz], seed);
        dot(slope, sub(offset, [dx as f32, dy as f32, dz as f32]))
    };
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let near = mix(mix(at(0, 0, 0), at(1, 0, 0), t[0]), mix(at(0, 1, 0), at(1, 1, 0), t[0]), t[1]);
    let far = mix(mix(at(0, 0, 1), at(1, 0, 1), t[0]), mix(at(0, 1, 1), at(1, 1, 1), t[0]), t[1]);
    mix(near, far, t[2])
}

/// Components from −1 to 1 of an integer point, ten bits each, by the finalizer of MurmurHash3
/// (Appleby 2011).
fn gradient(point: [i32; 3], seed: u32) -> Vec3 {
    let mut x = seed;
    for (k, factor) in [0x8da6_b343_u32, 0xd816_3841, 0xcb1a_b31f].into_iter().enumerate() {
        x ^= (point[k] as u32).wrapping_mul(factor);
        x = x.rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64);
    }
    x ^= x >> 16;
    x = x.wrapping_mul(0x85eb_ca6b);
    x ^= x >> 13;
    x = x.wrapping_mul(0xc2b2_ae35);
    x ^= x >> 16;
    [0, 10, 20].map(|shift| (x >> shift & 1023) as f32 * (2.0 / 1023.0) - 1.0)
}
