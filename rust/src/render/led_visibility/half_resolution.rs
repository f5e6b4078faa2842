//! Shadow rays at half resolution, and tiles whose visibility they determine.

use super::{BLOCK, Samples, TilePoints, bits_of, lanes_of};
use crate::render::ray_table::TileRays;
use crate::render::tile::{Scratch, TileRenderer};
use crate::simd::f32x64::*;

/// Number of half-resolution pixels along a tile.
const HALF: usize = TILE / BLOCK;

/// Visibility of LEDs in blocks of 2 × 2 tiles.
pub struct Blocks {
    columns: usize,
    num_leds: usize,
    all: Vec<Block>,
    /// For each block and each LED, a bit for each lane whose ray is unoccluded.
    lit: Vec<u64>,
}

/// One block.
#[derive(Clone, Copy)]
struct Block {
    /// A bit for each lane that has a point.
    used: u64,
    /// True if it has been traced.
    is_traced: bool,
}

/// A row of blocks, and the surfaces that its tiles show.
pub struct BlockRow<S> {
    /// Visible surface of each tile, row by row.
    pub seen: Vec<S>,
    /// Points of each tile.
    pub points: Vec<TilePoints>,
    /// Visibility of LEDs.
    pub blocks: Blocks,
}

/// Traces the camera rays of up to two rows of tiles, and shadow rays at half resolution.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn block_row<T: TileRenderer>(
    renderer: &T,
    samples: &Samples<'_>,
    tiles: &[TileRays],
    columns: usize,
) -> BlockRow<T::Seen> {
    let mut scratch = Scratch::default();
    let seen: Vec<T::Seen> = tiles.iter().map(|tile| renderer.see(tile, &mut scratch)).collect();
    let points: Vec<TilePoints> =
        tiles.iter().zip(&seen).map(|(tile, seen)| renderer.points(tile, seen)).collect();
    let mut blocks = Blocks::new(columns.div_ceil(BLOCK), samples.leds.len());
    for column in (0..columns).step_by(BLOCK) {
        let (mut ends, mut used) = ([[0.0; LANES]; 3], [false; LANES]);
        let mut is_traced = true;
        for (row, tiles) in tiles.chunks(columns).enumerate() {
            for offset in 0..BLOCK.min(columns - column) {
                is_traced &= !tiles[column + offset].is_wide;
                let own = &points[row * columns + column + offset];
                pick((row, offset), own, (&mut ends, &mut used));
            }
        }
        blocks.all.push(Block { used: bits_of(&used), is_traced });
        for k in 0..samples.leds.len() {
            let mut lit = 0;
            if is_traced && used.contains(&true) {
                lit = samples.lit(k, &ends, &used);
                let place = samples.leds[k].position;
                renderer.shade_particles(place, &ends, &mut scratch, &mut lit);
            }
            blocks.lit.push(lit);
        }
    }
    BlockRow { seen, points, blocks }
}

/// Picks one pixel of each 2 × 2 pixels of a tile at a position in its block.
#[inline(always)]
fn pick(
    (row, column): (usize, usize),
    points: &TilePoints,
    (ends, used): (&mut Lane3, &mut [bool; LANES]),
) {
    let is_used = lanes_of(points.used);
    for y in 0..HALF {
        for x in 0..HALF {
            // Corners of the 2 × 2 pixels alternate; the next one if the first has no surface.
            let corners = (0..BLOCK * BLOCK).map(|k| (2 * x + y + k) % (BLOCK * BLOCK));
            let lanes = corners.map(|c| (BLOCK * y + c / BLOCK) * TILE + BLOCK * x + c % BLOCK);
            let Some(from) = lanes.into_iter().find(|&lane| is_used[lane]) else { continue };
            let lane = (row * HALF + y) * TILE + column * HALF + x;
            used[lane] = true;
            for k in 0..3 {
                ends[k][lane] = points.position[k][from];
            }
        }
    }
}

impl Blocks {
    /// No blocks yet; rows have `columns` tiles.
    pub fn new(columns: usize, num_leds: usize) -> Self {
        Blocks { columns, num_leds, all: Vec::new(), lit: Vec::new() }
    }

    /// Adds a row.
    pub fn push(&mut self, row: Blocks) {
        self.all.extend(row.all);
        self.lit.extend(row.lit);
    }

    /// True if LED `k` lights all points in and around a tile, false if none; None if it varies.
    ///
    /// The margin is included because a tile at the end of a wide penumbra may hold none of the few
    /// samples that differ.
    #[inline(always)]
    pub fn uniform(&self, (row, column): (usize, usize), k: usize) -> Option<bool> {
        let (mut lit, mut dark) = (0, 0);
        let (rows, columns) = (Span::of(row), Span::of(column));
        let num_rows = self.all.len() / self.columns;
        for block_row in rows.blocks(num_rows) {
            for block_column in columns.blocks(self.columns) {
                let number = block_row * self.columns + block_column;
                let Block { used, is_traced } = self.all[number];
                if !is_traced {
                    return None;
                }
                let mask = used & rows.row_mask(block_row) & columns.column_mask(block_column);
                let bits = self.lit[number * self.num_leds + k];
                lit |= bits & mask;
                dark |= !bits & mask;
            }
        }
        if lit != 0 && dark != 0 { None } else { Some(dark == 0) }
    }
}

/// First and last half-resolution pixel along a tile, with one more on either side.
#[derive(Clone, Copy)]
struct Span(usize, usize);

impl Span {
    fn of(tile: usize) -> Self {
        Span((tile * HALF).saturating_sub(1), (tile + 1) * HALF)
    }

    /// Blocks that it overlaps, of `count`.
    #[inline(always)]
    fn blocks(self, count: usize) -> std::ops::Range<usize> {
        self.0 / TILE..count.min(self.1 / TILE + 1)
    }

    /// First and last of its pixels in a block.
    #[inline(always)]
    fn inside(self, block: usize) -> (usize, usize) {
        let first = self.0.saturating_sub(block * TILE);
        (first, (self.1 - block * TILE).min(TILE - 1))
    }

    /// Its lanes in a block, if it runs along a row.
    #[inline(always)]
    fn column_mask(self, block: usize) -> u64 {
        let (first, last) = self.inside(block);
        ((0xff >> (TILE - 1 - last)) & (0xff << first) & 0xff) * 0x0101_0101_0101_0101
    }

    /// Its lanes in a block, if it runs along a column.
    #[inline(always)]
    fn row_mask(self, block: usize) -> u64 {
        let (first, last) = self.inside(block);
        (u64::MAX >> (TILE * (TILE - 1 - last))) & (u64::MAX << (TILE * first))
    }
}
