//! LEDs: luminous discs perpendicular to their axes, or points if their radius is 0.

use crate::render::path::bsdf::{circle, frame};
use crate::render::path::sobol::{dimension, hash, point, unit};
use crate::simd::f32x64::*;
use std::sync::LazyLock;

/// An LED in the frame of the wall.
#[derive(Clone, Copy)]
pub struct Led {
    /// Center [m].
    pub position: Vec3,
    /// Unit direction of its axis.
    pub direction: Vec3,
    /// Radiant intensity on its axis [W/sr] for red, green, blue.
    pub intensity: Vec3,
    /// Exponent of its angular lobe cosᵐ.
    pub exponent: f32,
    /// Radius of its emitting disc [m]; 0 for a point.
    pub radius: f32,
}

impl Led {
    /// Point of the disc relative to its center [m]; uniform if `numbers` are, in the unit square.
    #[inline(always)]
    pub fn offset(&self, numbers: [f32; 2]) -> Vec3 {
        if self.radius == 0.0 {
            return [0.0; 3];
        }
        let [right, up] = frame(self.direction);
        let [x, y] = on_disc(numbers);
        add(scale(right, self.radius * x), scale(up, self.radius * y))
    }

    /// Relative intensity at a cosine of the angle to its axis.
    #[inline(always)]
    pub fn lobe(&self, cosine: f32) -> f32 {
        match self.exponent {
            0.0 => 1.0,
            1.0 => cosine,
            m => pow(cosine, m),
        }
    }

    /// Area over π of the half vectors between a view and the disc, for a squared distance [m²] and
    /// the cosines of the angle to the LED's axis and of that between view and half vector.
    ///
    /// An element of half vectors is the element of light directions over four times the latter
    /// (Walter et al. 2007, eq. 14).
    #[inline(always)]
    pub fn half_vectors(&self, square: f32, cosine: f32, difference: f32) -> f32 {
        self.radius * self.radius * cosine / (4.0 * square * max(difference, 0.1))
    }

    /// `count` point lights for the LED, chosen by `key`; the LED itself if it is a point.
    pub fn points(&self, count: u32, key: u32) -> Vec<Led> {
        if self.radius == 0.0 {
            return vec![*self];
        }
        let intensity = scale(self.intensity, 1.0 / count as f32);
        let led = |k| {
            let position = add(self.position, self.offset(point(key, k)));
            Led { position, intensity, radius: 0.0, ..*self }
        };
        (0..count).map(led).collect()
    }
}

/// Point lights of all LEDs of a camera, `samples` for each.
pub fn point_leds(leds: &[Led], samples: u32, seed: u64) -> Vec<Led> {
    let key = hash(hash(seed as u32 ^ 0x2545_f491) ^ (seed >> 32) as u32);
    let number = |(k, led): (usize, &Led)| led.points(samples, dimension(key, k as u32));
    leds.iter().enumerate().flat_map(number).collect()
}

/// Point of the unit disc: a mapping of the unit square that preserves areas and neighbors (Shirley
/// and Chiu 1997).
#[inline(always)]
pub fn on_disc([u, v]: [f32; 2]) -> [f32; 2] {
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    let (radius, turn) = if a.abs() > b.abs() {
        (a, 0.125 * b / a)
    } else {
        (b, if b == 0.0 { 0.0 } else { 0.25 - 0.125 * a / b })
    };
    let (cosine, sine) = circle(turn);
    [radius * cosine, radius * sine]
}

/// Side of the square of pixels that holds each sample once.
pub const PERIOD: usize = 4;
/// Number of samples of a disc.
pub const SAMPLES: usize = PERIOD * PERIOD;

/// Factor on the 16 samples that gives them the second moment of the disc, 1/2; without it they
/// have 0.449.
const SPREAD: f32 = 1.055_02;

/// Order of the samples in a square of pixels (Bayer 1973): each 2 × 2 neighborhood has one sample
/// of each quarter of the sequence.
const ORDER: [[usize; PERIOD]; PERIOD] =
    [[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]];

/// Point in a plane.
type Vec2 = [f32; 2];

/// Samples of the unit disc, by index.
static UNIT_DISC: LazyLock<[Vec2; SAMPLES]> =
    LazyLock::new(|| std::array::from_fn(|number| on_disc(net_point(number))));

/// Start of the shadow ray of each lane of a tile, relative to an LED's center: a sample of its
/// disc that repeats every `PERIOD` pixels.
///
/// The samples are a (0, 4, 2)-net (Hammersley's set): each 2 × 2 neighborhood has one in each
/// quarter of the disc, and the uniform mean over 4 × 4 pixels is a quadrature with 16 points at 16
/// different coordinates along either side. The points are scaled so that the mean square of their
/// distance from the center is that of the disc. The disc of each LED has a different rotation.
pub fn disc_samples(led: &Led, number: usize) -> Lane3 {
    let (cosine, sine) = circle((0.618_034 * number as f32 + 0.07).fract());
    let [right, up] = frame(led.direction);
    let samples: &[Vec2; SAMPLES] = &UNIT_DISC;
    let mut starts = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let [x, y] = samples[ORDER[i / TILE % PERIOD][i % PERIOD]];
        let (x, y) = (cosine * x - sine * y, sine * x + cosine * y);
        for k in 0..3 {
            starts[k][i] = SPREAD * led.radius * (right[k] * x + up[k] * y);
        }
    }
    starts
}

/// A lane of `disc_samples` that holds the sample of an index, in any order.
#[inline(always)]
pub fn sample_lane(number: usize) -> usize {
    number / PERIOD * TILE + number % PERIOD
}

/// Point of the net in the unit square; each run of four indices lies in one quarter.
fn net_point(number: usize) -> [f32; 2] {
    let (quarter, rest) = (number as u32 / PERIOD as u32, number as u32 % PERIOD as u32);
    let index = (quarter & 1) << 3 | rest << 1 | quarter >> 1;
    let half_cell = 0.5 / SAMPLES as f32;
    [index as f32 / SAMPLES as f32 + half_cell, unit(index.reverse_bits()) + half_cell]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbors_sample_all_quarters_of_a_disc() {
        let led = Led {
            position: [0.0; 3],
            direction: [0.0, 0.0, 1.0],
            intensity: [1.0; 3],
            exponent: 1.0,
            radius: 1.0,
        };
        let quarter = |number: usize| net_point(number).map(|x| u32::from(x > 0.5));
        for row in 0..PERIOD {
            for column in 0..PERIOD {
                let mut seen: Vec<_> = [(0, 0), (0, 1), (1, 0), (1, 1)]
                    .map(|(y, x)| quarter(ORDER[(row + y) % PERIOD][(column + x) % PERIOD]))
                    .to_vec();
                seen.sort_unstable();
                seen.dedup();
                assert_eq!(seen.len(), 4);
            }
        }
        // The mean squared distance from the center of a uniform disc is half the squared radius.
        let [x, y, z] = disc_samples(&led, 3);
        let square: f32 = (0..LANES).map(|i| x[i] * x[i] + y[i] * y[i]).sum();
        assert!((square / LANES as f32 - 0.5).abs() < 0.01);
        assert!(z.iter().all(|&z| z == 0.0));
    }

    #[test]
    fn points_of_an_led_share_its_light() {
        let led = Led {
            position: [1.0, 2.0, 3.0],
            direction: [0.0, 0.6, 0.8],
            intensity: [3.0, 2.0, 1.0],
            exponent: 1.0,
            radius: 0.5,
        };
        let points = led.points(64, 7);
        let (mut light, mut center) = (0.0, [0.0; 3]);
        for point in &points {
            let offset = sub(point.position, led.position);
            assert!(dot(offset, offset) <= 0.25 && dot(offset, led.direction).abs() < 1e-6);
            assert_eq!(point.radius, 0.0);
            light += point.intensity[0];
            center = add(center, scale(offset, 1.0 / 64.0));
        }
        assert!((light - 3.0).abs() < 1e-5 && dot(center, center) < 1e-4);
    }
}
