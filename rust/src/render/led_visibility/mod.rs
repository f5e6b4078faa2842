//! Soft shadows: visible fraction of each LED's disc in each pixel.
//!
//! 1. One pixel of each 2 × 2 traces a ray to a sample of each LED's disc. If all rays to an LED
//!    in and around a tile are unoccluded, or none, that result holds for the whole tile.
//! 2. Otherwise each pixel traces a ray to its own sample. Samples repeat every four pixels.
//! 3. A pixel takes the mean over its neighbors on the same surface, see `filter`; near an LED it
//!    traces rays to all samples instead, see `near_discs`.
//!
//! The method is deterministic: neighbors have different samples, and each mean covers all of them.

mod filter;
mod half_resolution;
mod near_discs;

use crate::render::led::{Led, disc_samples};
use crate::render::ray_table::TileRays;
use crate::render::tile::{Scratch, TileRenderer};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::bundle::{RAYS, lit_by};
use crate::wall::disc_visibility::{DiscRays, visible_from_disc};
use half_resolution::{Blocks, block_row};
use near_discs::NearLanes;
use rayon::prelude::*;

/// Rows and columns of tiles in a block, whose half-resolution pixels form one tile.
pub const BLOCK: usize = 2;

/// Points hit by the rays of a tile.
#[derive(Clone)]
pub struct TilePoints {
    /// Points [m].
    pub position: Lane3,
    /// A bit for each lane with a hit.
    pub used: u64,
    /// Distance from the camera [m].
    pub distance: Lane,
}

/// LEDs, and the start of each lane's shadow ray on their discs.
pub struct Samples<'a> {
    wall: &'a Wall,
    leds: &'a [Led],
    starts: Vec<Lane3>,
}

/// Visibility of LEDs in some rows of tiles.
pub struct LedVisibility<'a> {
    samples: &'a Samples<'a>,
    columns: usize,
    points: Vec<TilePoints>,
    /// For each tile and each LED, a bit for each lane whose ray is unoccluded.
    lit: Vec<u64>,
    /// Visible samples of near LEDs, for each tile and each LED.
    near: Vec<NearLanes>,
}

/// Surfaces visible in some rows of tiles, and the LEDs that light them.
pub struct Strip<'a, S> {
    /// Visible surface of each tile.
    pub seen: Vec<S>,
    /// Visibility of the LEDs from these surfaces.
    pub visibility: LedVisibility<'a>,
}

impl<'a> Samples<'a> {
    /// Samples of the discs of LEDs.
    pub fn new(wall: &'a Wall, leds: &'a [Led]) -> Self {
        let starts = leds.iter().enumerate().map(|(k, led)| disc_samples(led, k)).collect();
        Samples { wall, leds, starts }
    }

    /// A bit for each point that is lit by LED `k`; particles are ignored.
    #[inline(always)]
    fn lit(&self, k: usize, ends: &Lane3, used: &[bool; LANES]) -> u64 {
        let Led { position, radius, .. } = self.leds[k];
        let rays = DiscRays { center: position, radius, starts: &self.starts[k], ends };
        visible_from_disc(self.wall, &rays, used, u32::MAX).0
    }
}

/// Lanes whose bits are set.
#[inline(always)]
pub fn lanes_of(bits: u64) -> [bool; LANES] {
    std::array::from_fn(|i| bits >> i & 1 == 1)
}

/// A bit for each lane that is true.
#[inline(always)]
pub fn bits_of(lanes: &[bool; LANES]) -> u64 {
    let mut bits = 0;
    for i in 0..LANES {
        bits |= u64::from(lanes[i]) << i;
    }
    bits
}

impl<'a, S: Send + Sync> Strip<'a, S> {
    /// Traces rows of tiles, starting at an even row, and shadow rays to the LEDs.
    pub fn trace<T: TileRenderer<Seen = S> + Sync>(
        renderer: &T,
        samples: &'a Samples<'a>,
        tiles: &[TileRays],
        columns: usize,
    ) -> Self {
        let rows: Vec<_> = tiles
            .par_chunks(BLOCK * columns)
            .with_max_len(1)
            .map(|tiles| block_row(renderer, samples, tiles, columns))
            .collect();
        let (mut seen, mut points) =
            (Vec::with_capacity(tiles.len()), Vec::with_capacity(tiles.len()));
        let mut blocks = Blocks::new(columns.div_ceil(BLOCK), samples.leds.len());
        for row in rows {
            seen.extend(row.seen);
            points.extend(row.points);
            blocks.push(row.blocks);
        }
        let lit: Vec<Vec<u64>> = tiles
            .par_chunks(columns)
            .zip(points.par_chunks(columns))
            .with_max_len(1)
            .enumerate()
            .map(|(row, (tiles, points))| {
                refine_row(renderer, samples, (tiles, points), (row, &blocks))
            })
            .collect();
        let (lit, near) = (lit.concat(), Vec::new());
        let mut visibility = LedVisibility { samples, columns, points, lit, near };
        visibility.sample_near_discs(renderer, tiles);
        Strip { seen, visibility }
    }
}

/// Traces a shadow ray from each pixel to each LED whose visibility varies around its tile.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn refine_row<T: TileRenderer>(
    renderer: &T,
    samples: &Samples<'_>,
    (tiles, points): (&[TileRays], &[TilePoints]),
    (row, blocks): (usize, &Blocks),
) -> Vec<u64> {
    let (num_leds, mut scratch) = (samples.leds.len(), Scratch::default());
    let mut out = vec![0; tiles.len() * num_leds];
    for (column, (tile, points)) in tiles.iter().zip(points).enumerate() {
        let lit = &mut out[column * num_leds..(column + 1) * num_leds];
        let used = lanes_of(points.used);
        if tile.is_wide {
            trace_by_point(samples, points, &used, lit);
        }
        for (k, lit) in lit.iter_mut().enumerate() {
            if !tile.is_wide {
                if let Some(uniform) = blocks.uniform((row, column), k) {
                    *lit = if uniform { points.used } else { 0 };
                    continue;
                }
                *lit = samples.lit(k, &points.position, &used);
            }
            let place = samples.leds[k].position;
            renderer.shade_particles(place, &points.position, &mut scratch, lit);
        }
    }
    out
}

/// Traces the shadow rays of each point of a tile together.
#[inline(always)]
fn trace_by_point(
    samples: &Samples<'_>,
    points: &TilePoints,
    used: &[bool; LANES],
    lit: &mut [u64],
) {
    for (chunk, leds) in samples.leds.chunks(RAYS).enumerate() {
        let starts = &samples.starts[chunk * RAYS..];
        let source = |i: usize, k: usize| add(leds[k].position, at(&starts[k], i));
        let of_points = lit_by(samples.wall, (leds.len(), source), &points.position, used);
        for k in 0..leds.len() {
            for i in 0..LANES {
                lit[chunk * RAYS + k] |= u64::from(of_points[i] >> k & 1) << i;
            }
        }
    }
}
