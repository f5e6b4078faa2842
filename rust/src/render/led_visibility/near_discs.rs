//! Light of LEDs that are near a surface, by rays to all samples of a disc.
//!
//! There irradiance is many times higher than elsewhere, and the means over neighbors in `filter`
//! are too inaccurate at the edges of folds.

use super::{LedVisibility, Samples, bits_of, lanes_of};
use crate::render::led::{SAMPLES, sample_lane};
use crate::render::ray_table::TileRays;
use crate::render::tile::{Scratch, TileRenderer};
use crate::simd::f32x64::*;
use crate::wall::bundle::{RAYS, lit_by};
use rayon::prelude::*;

/// Squared ratio of an LED's radius to its distance above which it is near: 9 radii.
const NEAR: f32 = 0.0123;

/// A bit for each lane that is near an LED, and a bit for each sample of the LED visible there.
pub type NearLanes = Option<Box<(u64, [u16; LANES])>>;

impl Samples<'_> {
    /// A bit for each used point that is near LED `k`.
    #[inline(always)]
    fn near(&self, k: usize, points: &Lane3, used: u64) -> u64 {
        let (center, limit) = (self.leds[k].position, NEAR / (self.leds[k].radius.powi(2)));
        let mut is_near = [false; LANES];
        for i in 0..LANES {
            let offset = sub(at(points, i), center);
            is_near[i] = dot(offset, offset) * limit < 1.0;
        }
        bits_of(&is_near) & used
    }

    /// A bit for each sample of LED `k` visible from each point; particles are ignored.
    #[inline(always)]
    fn visible(&self, k: usize, points: &Lane3, used: &[bool; LANES]) -> [u16; LANES] {
        let mut visible = [0; LANES];
        for first in (0..SAMPLES).step_by(RAYS) {
            let source = |_: usize, n: usize| self.place(k, first + n);
            let lit = lit_by(self.wall, (RAYS, source), points, used);
            for i in 0..LANES {
                visible[i] |= (lit[i] << first) as u16;
            }
        }
        visible
    }

    /// Position of a sample of LED `k` [m].
    #[inline(always)]
    fn place(&self, k: usize, sample: usize) -> Vec3 {
        add(self.leds[k].position, at(&self.starts[k], sample_lane(sample)))
    }

    /// Visible fraction of LED `k` at points with unit normals, from the samples visible from each.
    ///
    /// It is the fraction of the disc above the horizon, times the fraction of its light that
    /// arrives: samples near the horizon are often occluded and contribute little.
    #[inline(always)]
    pub fn near_fraction(
        &self,
        k: usize,
        (points, normals): (&Lane3, &Lane3),
        visible: &[u16; LANES],
    ) -> Lane {
        let led = &self.leds[k];
        let (mut above, mut sent, mut arriving) = ([0.0; LANES], [1e-30; LANES], [0.0; LANES]);
        for sample in 0..SAMPLES {
            let start = self.place(k, sample);
            for i in 0..LANES {
                let offset = sub(start, at(points, i));
                let square = max(dot(offset, offset), 1e-10);
                let height = max(dot(offset, at(normals, i)), 0.0);
                let lobe = led.lobe(max(-dot(offset, led.direction) / square.sqrt(), 0.0));
                let light = lobe * height / (square * square.sqrt());
                above[i] += if height > 0.0 { 1.0 / SAMPLES as f32 } else { 0.0 };
                sent[i] += light;
                arriving[i] += if visible[i] >> sample & 1 == 1 { light } else { 0.0 };
            }
        }
        std::array::from_fn(|i| above[i] * arriving[i] / sent[i])
    }
}

impl LedVisibility<'_> {
    /// Traces rays to all samples of the LEDs that are near a tile and whose visibility varies.
    pub fn sample_near_discs<T: TileRenderer + Sync>(&mut self, renderer: &T, tiles: &[TileRays]) {
        let rows = tiles.par_chunks(self.columns).with_max_len(1).enumerate();
        let near: Vec<Vec<NearLanes>> =
            rows.map(|(row, tiles)| sample_row(renderer, tiles, (row, self))).collect();
        self.near = near.into_iter().flatten().collect();
    }
}

/// Visible samples of near LEDs in a row of tiles.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn sample_row<T: TileRenderer>(
    renderer: &T,
    tiles: &[TileRays],
    (row, visibility): (usize, &LedVisibility<'_>),
) -> Vec<NearLanes> {
    let samples = visibility.samples;
    let (num_leds, mut scratch) = (samples.leds.len(), Scratch::default());
    let mut out = Vec::with_capacity(tiles.len() * num_leds);
    for column in 0..tiles.len() {
        let points = &visibility.points[row * visibility.columns + column];
        let neighbors = visibility.neighbors(row, column);
        for k in 0..num_leds {
            let near = samples.near(k, &points.position, points.used);
            if near == 0 || visibility.uniform(&neighbors, k).is_some() {
                out.push(None);
                continue;
            }
            let mut visible = samples.visible(k, &points.position, &lanes_of(near));
            let (place, mut clear) = (samples.leds[k].position, near);
            renderer.shade_particles(place, &points.position, &mut scratch, &mut clear);
            for (visible, is_clear) in visible.iter_mut().zip(lanes_of(clear)) {
                *visible = if is_clear { *visible } else { 0 };
            }
            out.push(Some(Box::new((near, visible))));
        }
    }
    out
}
