//! Turbid fluid between the capsule and the wall: extinction of the wall's light, backscattered
//! light of the LEDs, and the fraction of light that reaches the camera unscattered.
//!
//! All are integrated along some 40 rays across the image (Wronski 2014, SIGGRAPH course
//! "Volumetric fog": a grid in the frustum) and interpolated at the distance of the wall in each
//! pixel. Extinction coefficients are those of transport, `absorption + (1 − g) scattering`: light
//! that is scattered forward stays in the beam. Orders of scattering beyond the first have the
//! attenuation to the power 1/2, 1/4, … (Wrenninge, Kulla and Lundqvist 2013, "Oz: the great and
//! volumetric") and weights that give a half-space its true brightness (see `render/medium.py`).

use crate::mucosa::noise::{exp, smoothstep};
use crate::pool::on_pool;
use crate::render::cloud_noise::{fractal, octave};
use crate::simd::f32x64::{Vec3, clamp, dot, max, pow, scale, sub};
use numpy::{IntoPyArray, PyArray2, PyArray3, ndarray};
use numpy::{PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Approximate number of integrated rays across the image; some 4 degrees apart in a wide view.
const RAYS: usize = 40;
/// Number of intervals along a ray; they grow with distance.
const SLICES: usize = 16;
/// Number of their ends.
const ENDS: usize = SLICES + 1;
/// Number of orders of scattering; the last represents all higher orders.
const ORDERS: usize = 5;
/// Maximum distance from which light returns [m].
const FARTHEST: f32 = 0.1;

/// Extinction by flocs averaged over space, relative to that inside them.
const MEAN_FLOCS: f32 = 0.016;

/// Values of a node of the grid: backscattered light [3], transmittance of the camera's path [3]
/// and of the LEDs' paths [3], optical depth of scattering, and zeros that fill a vector.
const VALUES: usize = 16;
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
    let rows = spline(y, grid.step, grid.rays.len() / grid.columns);
    let mut depths = vec![0.0; distance.len()];
    for (x, &distance) in distance.iter().enumerate() {
        let Some(ray) = rig.ray(y * rig.size.1 + x) else { continue };
        let Some(node) = grid.at(rig, (&rows, x), ray, distance) else { continue };
        for k in 0..3 {
            veil[k][x] = node[k];
            image[[k, x]] *= node[3 + k] * node[6 + k];
        }
        depths[x] = node[9];
    }
    for (clear, depth) in clear.iter_mut().zip(depths) {
        *clear = exp(-depth);
    }
}

/// Integrals along the rays of every few pixels, at the ends of all intervals.
struct Grid {
    /// Pixels between rays.
    step: usize,
    columns: usize,
    /// None outside the camera's field of view.
    rays: Vec<Option<Box<[Node; ENDS]>>>,
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
            rig.ray(y * width + x).map(|ray| integrate(medium, rig, ray, cell))
        });
        Grid { step, columns, rays: rays.collect() }
    }

    /// Values at a distance along the ray of a pixel, given the rows of `spline`; None if no node
    /// near it is known.
    #[inline(always)]
    fn at(
        &self,
        rig: &Rig<'_>,
        (rows, x): (&[(usize, f32); 3], usize),
        (_, start): (Vec3, f32),
        distance: f32,
    ) -> Option<Node> {
        let distance = if distance.is_finite() { distance } else { FARTHEST };
        let along = ((distance - start) / (rig.farthest - start).max(1e-6)).clamp(0.0, 1.0);
        let along = along.sqrt() * SLICES as f32;
        let slice = (along as usize).min(SLICES - 1);
        let t = along - slice as f32;
        let (mut sum, mut whole) = ([0.0; VALUES], 0.0);
        let columns = spline(x, self.step, self.columns);
        for &(row, v) in rows {
            for (column, u) in columns {
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

    /// Points at distances along a ray, in the frame to which the clouds are fixed [m].
    #[inline(always)]
    fn fixed<const N: usize>(&self, ray: Vec3, distances: &[f32; N]) -> [[f32; N]; 3] {
        let mut fixed = [[0.0; N]; 3];
        for (k, row) in self.pose.chunks_exact(4).enumerate() {
            let along = row[0] * ray[0] + row[1] * ray[1] + row[2] * ray[2];
            for i in 0..N {
                fixed[k][i] = distances[i] * along + row[3];
            }
        }
        fixed
    }
}

/// Integrals along a ray from the distance at which it leaves the capsule, given the angle to the
/// next ray.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn integrate(
    medium: &Medium,
    rig: &Rig<'_>,
    (ray, start): (Vec3, f32),
    cell: f32,
) -> Box<[Node; ENDS]> {
    let length = max(rig.farthest - start, 1e-6);
    let part = |k: usize| k as f32 / SLICES as f32;
    let ends: [f32; ENDS] = std::array::from_fn(|k| start + length * part(k) * part(k));
    let middles: [f32; SLICES] = std::array::from_fn(|k| 0.5 * (ends[k] + ends[k + 1]));
    let (density, flocs) = medium.densities(rig, ray, &middles, cell);
    // Optical depths of transport by color, and of scattering.
    let (mut depths, mut halfway) = ([[0.0; ENDS]; 3], [[0.0; SLICES]; 3]);
    let (mut back, mut scattered) = ([[0.0; SLICES]; 3], [0.0; ENDS]);
    for k in 0..3 {
        let reflected = (1.0 - medium.anisotropy) * medium.scattering[k];
        for i in 0..SLICES {
            let step = ends[i + 1] - ends[i];
            let lost = density[i] * (medium.absorption[k] + reflected) + flocs[i] + medium.stain[k];
            back[k][i] = density[i] * reflected + flocs[i] * medium.floc_color[k];
            halfway[k][i] = depths[k][i] + 0.5 * step * lost;
            depths[k][i + 1] = depths[k][i] + step * lost;
        }
    }
    for i in 0..SLICES {
        let forward = density[i] * medium.anisotropy * medium.scattering[1];
        scattered[i + 1] = scattered[i] + (ends[i + 1] - ends[i]) * forward;
    }
    let mut nodes = Box::new([[0.0; VALUES]; ENDS]);
    let arriving = arriving(rig, (ray, start), &ends, &depths);
    for (i, node) in nodes.iter_mut().enumerate() {
        for k in 0..3 {
            (node[3 + k], node[6 + k]) = (exp(-depths[k][i]), arriving[k][i]);
        }
        node[9] = scattered[i];
    }
    if back.iter().flatten().any(|&back| back > 0.0) {
        let light = medium.scattered(rig, (ray, start), &middles, &halfway);
        for i in 0..SLICES {
            for k in 0..3 {
                let step = ends[i + 1] - ends[i];
                nodes[i + 1][k] = nodes[i][k] + step * back[k][i] * light[k][i];
            }
        }
    }
    nodes
}

/// Fraction of the light of the LEDs that arrives at distances along a ray from its start, by
/// color, given the optical depths of the ray: extinction on the way from an LED is taken from it.
#[inline(always)]
fn arriving<const N: usize>(
    rig: &Rig<'_>,
    (ray, start): (Vec3, f32),
    at: &[f32; N],
    depths: &[[f32; N]; 3],
) -> [[f32; N]; 3] {
    let (mut lit, mut all) = ([[0.0; N]; 3], [[0.0; N]; 3]);
    for led in &rig.leds {
        let (arrives, ratio) = irradiance(led, (ray, start), at);
        for k in 0..3 {
            for i in 0..N {
                all[k][i] += led[6 + k] * arrives[i];
                lit[k][i] += led[6 + k] * arrives[i] * exp(-depths[k][i] * ratio[i]);
            }
        }
    }
    for k in 0..3 {
        for i in 0..N {
            let is_lit = all[k][i] > 0.0;
            lit[k][i] = if is_lit { lit[k][i] / all[k][i] } else { exp(-depths[k][i]) };
        }
    }
    lit
}

impl Medium {
    /// Radiance per scattering coefficient that points along a ray send to the camera, by color,
    /// after extinction on both paths, summed over all orders of scattering.
    #[inline(always)]
    fn scattered<const N: usize>(
        &self,
        rig: &Rig<'_>,
        (ray, start): (Vec3, f32),
        at: &[f32; N],
        depths: &[[f32; N]; 3],
    ) -> [[f32; N]; 3] {
        let mut sum = [[0.0; N]; 3];
        for led in &rig.leds {
            let (arrives, ratio) = irradiance(led, (ray, start), at);
            for k in 0..3 {
                for i in 0..N {
                    let mut transmitted = exp(-depths[k][i] * (1.0 + ratio[i]));
                    let (mut weight, mut orders) = (1.0, 0.0);
                    for order in 0..ORDERS {
                        let last = order + 1 == ORDERS;
                        let rest = if last { 1.0 - self.orders[k] } else { 1.0 };
                        orders += transmitted * weight / rest;
                        transmitted = transmitted.sqrt();
                        weight *= 0.5 * self.orders[k];
                    }
                    sum[k][i] += led[6 + k] * arrives[i] * orders / (4.0 * PI);
                }
            }
        }
        sum
    }

    /// Densities relative to the mean, and extinctions by flocs [1/m], at distances along a ray, given
    /// the angle to the next ray. Flocs fade to their mean where they are less than four rays apart,
    /// which would show them as blocks.
    #[inline(always)]
    fn densities<const N: usize>(
        &self,
        rig: &Rig<'_>,
        ray: Vec3,
        at: &[f32; N],
        cell: f32,
    ) -> ([f32; N], [f32; N]) {
        let (mut density, mut flocs) = ([1.0; N], [0.0; N]);
        let points = rig.fixed(ray, at);
        let (spread, size) = self.clouds;
        if spread > 0.0 {
            // Wisps: the clouds are elongated along one direction.
            let mut wisps = [[0.0; N]; 3];
            for i in 0..N {
                let [x, y, z] = [0, 1, 2].map(|k| points[k][i]);
                (wisps[0][i], wisps[1][i], wisps[2][i]) =
                    (x / size, (y + 0.5 * z) / size, 0.4 * z / size);
            }
            let noise = fractal(&wisps, self.seed);
            for i in 0..N {
                density[i] = exp(spread * noise[i] - 0.5 * spread * spread);
            }
        }
        let (extinction, size) = self.flocs;
        if extinction > 0.0 {
            let noise = octave(&points, size, self.seed ^ 0x9e37_79b9);
            for i in 0..N {
                let floc = smoothstep(1.2, 1.8, noise[i]);
                let resolved = clamp(0.5 * size / max(cell * at[i], 1e-9) - 1.0, 0.0, 1.0);
                flocs[i] = extinction * (MEAN_FLOCS + resolved * (floc - MEAN_FLOCS));
            }
        }
        (density, flocs)
    }
}

/// Irradiance of surfaces that face an LED, at distances along a ray, for unit intensity [1/m²]; and
/// their distances from the LED relative to those along the ray, both less that to its start.
#[inline(always)]
fn irradiance<const N: usize>(
    led: &[f32; 10],
    (ray, start): (Vec3, f32),
    at: &[f32; N],
) -> ([f32; N], [f32; N]) {
    let (mut arrives, mut ratio) = ([0.0; N], [0.0; N]);
    let mut cosine = [0.0; N];
    for i in 0..N {
        let way = sub(scale(ray, at[i]), [led[0], led[1], led[2]]);
        let square = max(dot(way, way), 1e-8);
        let length = square.sqrt();
        cosine[i] = max(dot(way, [led[3], led[4], led[5]]) / length, 0.0);
        arrives[i] = 1.0 / square;
        ratio[i] = max(length - start, 0.0) / max(at[i] - start, 1e-6);
    }
    for i in 0..N {
        arrives[i] *= match led[9] {
            0.0 => 1.0,
            1.0 => cosine[i],
            exponent => pow(cosine[i], exponent),
        };
    }
    (arrives, ratio)
}
