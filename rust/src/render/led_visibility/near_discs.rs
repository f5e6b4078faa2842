//! Visible fractions of the discs of LEDs near a surface, by rays to all samples of a disc.
//!
//! There light is many times as bright as elsewhere, and the means over neighbors in `filter` are
//! not close enough at the edges of folds.

use super::{LedVisibility, Samples, bits_of, lanes_of};
use crate::render::led::{SAMPLES, sample_lane};
use crate::render::ray_table::TileRays;
use crate::render::tile::{Scratch, TileRenderer};
use crate::simd::f32x64::*;
use crate::wall::bundle::{RAYS, lit_by};
use rayon::prelude::*;

/// Square of an LED's radius over that of its distance above which it is near: 7 radii.
const NEAR: f32 = 0.02;

/// A bit for each lane that is near an LED, and the visible fraction of the LED there.
pub type NearLanes = Option<Box<(u64, Lane)>>;

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

    /// Fraction of the samples of LED `k` that each point sees, without particles in between.
    #[inline(always)]
    fn fraction(&self, k: usize, points: &Lane3, used: &[bool; LANES]) -> Lane {
        let (center, starts) = (self.leds[k].position, &self.starts[k]);
        let mut fraction = [0.0; LANES];
        for first in (0..SAMPLES).step_by(RAYS) {
            let source = |_: usize, n: usize| add(center, at(starts, sample_lane(first + n)));
            let lit = lit_by(self.wall, (RAYS, source), points, used);
            for i in 0..LANES {
                fraction[i] += lit[i].count_ones() as f32 * (1.0 / SAMPLES as f32);
            }
        }
        fraction
    }
}

impl LedVisibility {
    /// Traces rays to all samples of the LEDs that are near a tile and whose visibility varies.
    pub fn sample_near_discs<T: TileRenderer + Sync>(
        &mut self,
        renderer: &T,
        samples: &Samples<'_>,
        tiles: &[TileRays],
    ) {
        let rows = tiles.par_chunks(self.columns).with_max_len(1).enumerate();
        let near: Vec<Vec<NearLanes>> =
            rows.map(|(row, tiles)| sample_row(renderer, samples, tiles, (row, self))).collect();
        self.near = near.into_iter().flatten().collect();
    }
}

/// Visible fractions of near LEDs in a row of tiles.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn sample_row<T: TileRenderer>(
    renderer: &T,
    samples: &Samples<'_>,
    tiles: &[TileRays],
    (row, visibility): (usize, &LedVisibility),
) -> Vec<NearLanes> {
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
            let mut fraction = samples.fraction(k, &points.position, &lanes_of(near));
            let (place, mut clear) = (samples.leds[k].position, near);
            renderer.shade_particles(place, &points.position, &mut scratch, &mut clear);
            for (fraction, is_clear) in fraction.iter_mut().zip(lanes_of(clear)) {
                *fraction = if is_clear { *fraction } else { 0.0 };
            }
            out.push(Some(Box::new((near, fraction))));
        }
    }
    out
}
