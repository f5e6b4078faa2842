//! Mean of shadow rays over neighboring pixels on the same surface.
//!
//! Weights decrease at the ends of the kernel so that every sample of the period has the same total
//! weight: where visibility varies linearly, the mean is the quadrature over all samples of a disc.
//! Neighbors count if near the tangent plane of the pixel's point, at a similar distance.

use super::{LedVisibility, TilePoints, lanes_of};
use crate::simd::f32x64::*;

/// Number of pixels beyond a tile that the kernel reaches.
const MARGIN: usize = 2;
/// Side of a tile with its margin.
const SIDE: usize = TILE + 2 * MARGIN;
/// Weights of the kernel for samples that repeat every four pixels, and every two; the latter for
/// images with wide pixels.
const KERNELS: [[f32; 2 * MARGIN + 1]; 2] = [[0.5, 1.0, 1.0, 1.0, 0.5], [0.0, 0.5, 1.0, 0.5, 0.0]];
/// Sine of the angle to the tangent plane, and relative difference of distances, below which a
/// neighbor is on the same surface.
const PLANE: f32 = 0.35;
const DEPTH: f32 = 0.12;

/// A tile with its margin.
type Padded = [[f32; SIDE]; SIDE];

impl LedVisibility<'_> {
    /// Visible fraction of each LED in the pixels of a tile, given unit normals of the wall and
    /// with relief; `is_wide` for wide pixels.
    #[inline(always)]
    pub fn fractions(
        &self,
        (row, column): (usize, usize),
        [normals, relief]: [&Lane3; 2],
        is_wide: bool,
        out: &mut Vec<Lane>,
    ) {
        let own = row * self.columns + column;
        let neighbors = self.neighbors(row, column);
        let mut mixed = Vec::new();
        out.clear();
        for k in 0..self.num_leds() {
            let uniform = self.uniform(&neighbors, k);
            out.push([if uniform == Some(true) { 1.0 } else { 0.0 }; LANES]);
            if uniform.is_none() {
                mixed.push(k);
            }
        }
        if mixed.is_empty() {
            return;
        }
        let kernel = &KERNELS[usize::from(is_wide)];
        let weights = self.weights(own, (row, column), normals, kernel);
        for k in mixed {
            let bits = |tile: usize| self.lit[tile * self.num_leds() + k];
            let lit = self.padded_bits((row, column), bits);
            out[k] = mean(&weights, &lit);
            if let Some((near, visible)) = self.near[own * self.num_leds() + k].as_deref() {
                let points = &self.points[own].position;
                let fraction = self.samples.near_fraction(k, (points, relief), visible);
                for (i, is_near) in lanes_of(*near).into_iter().enumerate() {
                    out[k][i] = if is_near { fraction[i] } else { out[k][i] };
                }
            }
        }
    }

    #[inline(always)]
    fn num_leds(&self) -> usize {
        self.samples.leds.len()
    }

    /// True if LED `k` lights all lanes of a tile and its margin, false if none; None if it varies.
    #[inline(always)]
    pub fn uniform(&self, neighbors: &[(usize, u64)], k: usize) -> Option<bool> {
        let (mut lit, mut dark) = (0, 0);
        for &(tile, mask) in neighbors {
            let bits = self.lit[tile * self.num_leds() + k];
            lit |= bits & mask;
            dark |= !bits & mask;
        }
        if lit != 0 && dark != 0 { None } else { Some(lit != 0) }
    }

    /// The tile and the tiles around it, each with a bit for its used lanes within the margin.
    #[inline(always)]
    pub fn neighbors(&self, row: usize, column: usize) -> Vec<(usize, u64)> {
        let rows = self.points.len() / self.columns;
        let mut found = Vec::with_capacity(9);
        for (dy, y_mask) in [(0, 0xffff << 48), (1, u64::MAX), (2, 0xffff)] {
            for (dx, x_mask) in [(0, 0xc0), (1, 0xff), (2, 0x03u64)] {
                let (y, x) = (row + dy, column + dx);
                if y == 0 || x == 0 || y > rows || x > self.columns {
                    continue;
                }
                let tile = (y - 1) * self.columns + x - 1;
                let mask = y_mask & (x_mask * 0x0101_0101_0101_0101);
                found.push((tile, self.points[tile].used & mask));
            }
        }
        found
    }

    /// Values of a tile's pixels and its margin; 0 outside the image. `fill` writes the values of
    /// row `y` of a tile, starting at pixel `x`.
    #[inline(always)]
    fn padded(
        &self,
        (row, column): (usize, usize),
        fill: impl Fn(usize, (usize, usize), &mut [f32]),
    ) -> Padded {
        let rows = self.points.len() / self.columns;
        let mut padded = [[0.0; SIDE]; SIDE];
        for (y, out) in padded.iter_mut().enumerate() {
            let below = row * TILE + y;
            if below < MARGIN || below >= rows * TILE + MARGIN {
                continue;
            }
            let (tile_row, y) = ((below - MARGIN) / TILE, (below - MARGIN) % TILE);
            let tile = tile_row * self.columns + column;
            let (left, rest) = out.split_at_mut(MARGIN);
            let (middle, right) = rest.split_at_mut(TILE);
            if column > 0 {
                fill(tile - 1, (y, TILE - MARGIN), left);
            }
            fill(tile, (y, 0), middle);
            if column + 1 < self.columns {
                fill(tile + 1, (y, 0), right);
            }
        }
        padded
    }

    /// Bits of tiles as 0 or 1.
    #[inline(always)]
    fn padded_bits(&self, place: (usize, usize), bits: impl Fn(usize) -> u64) -> Padded {
        self.padded(place, |tile, (y, x), out| {
            let bits = bits(tile) >> (y * TILE + x);
            for (k, out) in out.iter_mut().enumerate() {
                *out = (bits >> k & 1) as i32 as f32;
            }
        })
    }

    /// Lane values of tiles.
    #[inline(always)]
    fn padded_lanes(&self, place: (usize, usize), lane: impl Fn(&TilePoints) -> &Lane) -> Padded {
        self.padded(place, |tile, (y, x), out| {
            let first = y * TILE + x;
            out.copy_from_slice(&lane(&self.points[tile])[first..first + out.len()]);
        })
    }

    /// Weight of each neighbor of the kernel, by offset; weights sum to 1.
    #[inline(always)]
    fn weights(
        &self,
        own: usize,
        place: (usize, usize),
        normals: &Lane3,
        kernel: &[f32; 2 * MARGIN + 1],
    ) -> Vec<(usize, usize, Lane)> {
        let points = &self.points;
        let used = self.padded_bits(place, |tile| points[tile].used);
        let distance = self.padded_lanes(place, |points| &points.distance);
        let [x, y, z] = [0, 1, 2].map(|k| self.padded_lanes(place, |points| &points.position[k]));
        let TilePoints { position: center, distance: own_distance, .. } = &points[own];
        let mut weights = Vec::with_capacity(kernel.len() * kernel.len());
        let mut total = [0.0f32; LANES];
        for (dy, along_y) in kernel.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            for (dx, along_x) in kernel.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
                let of = |padded: &Padded| shifted(padded, dy, dx);
                let (x, y, z, distance, used) = (of(&x), of(&y), of(&z), of(&distance), of(&used));
                let is_own = dy == MARGIN && dx == MARGIN;
                let most = along_y * along_x;
                let mut weight = [0.0; LANES];
                for i in 0..LANES {
                    let offset = sub([x[i], y[i], z[i]], at(center, i));
                    let height = dot(offset, at(normals, i));
                    let is_near = height * height <= PLANE * PLANE * dot(offset, offset);
                    let apart = (distance[i] - own_distance[i]).abs();
                    let is_same = is_near & (apart <= DEPTH * own_distance[i]) | is_own;
                    weight[i] = if is_same { most * used[i] } else { 0.0 };
                    total[i] += weight[i];
                }
                weights.push((dy, dx, weight));
            }
        }
        let mut inverse = [0.0; LANES];
        for i in 0..LANES {
            inverse[i] = 1.0 / max(total[i], 1e-6);
        }
        for (_, _, weight) in &mut weights {
            for i in 0..LANES {
                weight[i] *= inverse[i];
            }
        }
        weights
    }
}

/// Values of the neighbors at an offset.
#[inline(always)]
fn shifted(padded: &Padded, dy: usize, dx: usize) -> Lane {
    let mut lane = [0.0; LANES];
    for y in 0..TILE {
        lane[y * TILE..(y + 1) * TILE].copy_from_slice(&padded[y + dy][dx..dx + TILE]);
    }
    lane
}

/// Weighted mean around each pixel.
#[inline(always)]
fn mean(weights: &[(usize, usize, Lane)], values: &Padded) -> Lane {
    let mut sum = [0.0; LANES];
    for &(dy, dx, ref weight) in weights {
        let values = shifted(values, dy, dx);
        for i in 0..LANES {
            sum[i] += weight[i] * values[i];
        }
    }
    sum
}
