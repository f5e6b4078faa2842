//! Noise of clouds and flocs in turbid fluid, at points along a ray.

use crate::mucosa::noise::floor;
use crate::simd::f32x64::{Vec3, at, dot, sub};

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

/// Sum of octaves of noise at points, of mean 0 and standard deviation 0.69.
#[inline(always)]
pub fn fractal<const N: usize>(points: &[[f32; N]; 3], seed: u32) -> [f32; N] {
    let (mut sum, mut at, mut height) = ([0.0; N], *points, 1.0);
    for octave in 0..OCTAVES {
        at = turned(&at, if octave == 0 { 1.0 } else { 2.1 });
        let noise = gradient_noise(&at, seed.wrapping_add(octave.wrapping_mul(0x632b_e5ab)));
        for i in 0..N {
            sum[i] += height * noise[i] / SCALE;
        }
        height *= 0.6;
    }
    sum
}

/// One octave of noise of a size [m] at points [m], of mean 0 and standard deviation 0.69.
#[inline(always)]
pub fn octave<const N: usize>(points: &[[f32; N]; 3], size: f32, seed: u32) -> [f32; N] {
    let mut noise = gradient_noise(&turned(points, 1.0 / size), seed);
    for value in &mut noise {
        *value /= OCTAVE_SCALE;
    }
    noise
}

/// Points rotated by `TURN` and scaled.
#[inline(always)]
fn turned<const N: usize>(points: &[[f32; N]; 3], factor: f32) -> [[f32; N]; 3] {
    let mut turned = [[0.0; N]; 3];
    for k in 0..3 {
        for i in 0..N {
            turned[k][i] = factor * dot(TURN[k], at(points, i));
        }
    }
    turned
}

/// Gradient noise at points: 0 at integer points, with gradients of components from −1 to 1 (Perlin
/// 1985).
#[inline(always)]
fn gradient_noise<const N: usize>(points: &[[f32; N]; 3], seed: u32) -> [f32; N] {
    let mut noise = [0.0; N];
    for i in 0..N {
        let point = at(points, i);
        let corner = point.map(floor);
        let offset = sub(point, corner.map(|x| x as f32));
        let t = offset.map(|x| x * x * (3.0 - 2.0 * x));
        let value = |dx: i32, dy: i32, dz: i32| {
            let slope = gradient([corner[0] + dx, corner[1] + dy, corner[2] + dz], seed);
            dot(slope, sub(offset, [dx as f32, dy as f32, dz as f32]))
        };
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let line = |dy, dz| mix(value(0, dy, dz), value(1, dy, dz), t[0]);
        noise[i] = mix(mix(line(0, 0), line(1, 0), t[1]), mix(line(0, 1), line(1, 1), t[1]), t[2]);
    }
    noise
}

/// Components from −1 to 1 of an integer point, ten bits each, by the finalizer of MurmurHash3
/// (Appleby 2011).
#[inline(always)]
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
    [0, 10, 20].map(|shift| ((x >> shift) & 1023) as i32 as f32 * (2.0 / 1023.0) - 1.0)
}
