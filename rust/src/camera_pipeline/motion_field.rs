//! Motion of the image, sampled at some of its pixels.

use crate::render::channels::STEP;
use crate::simd::f32x64::{clamp, max, min};
use rayon::prelude::*;

/// Maximum number of fixed-point steps for the position that a late row exposes, and the change of
/// its motion at which they end [px per frame].
const FIXED_POINT_STEPS: usize = 4;
const SETTLED: f32 = 5e-2;
/// Number of samples processed together, and rows of samples that one thread takes.
const RUN: usize = 16;
const LINES: usize = 8;

/// Motion at every `STEP`th pixel of every `STEP`th row, the first at the center of a square of
/// `STEP` pixels [px per frame], without unknown samples.
pub struct MotionField {
    vectors: Vec<[f32; 2]>,
    size: (usize, usize),
}

impl MotionField {
    /// Fills unknown samples (NaN) next to known ones with their mean, up to three cells away, and
    /// others with zero.
    pub fn new(given: &[f32], size: (usize, usize)) -> Self {
        let (height, width) = size;
        let mut vectors: Vec<[f32; 2]> = given.chunks_exact(2).map(|v| [v[0], v[1]]).collect();
        let known = |v: &[f32; 2]| v[0].is_finite() && v[1].is_finite();
        let unknown: Vec<usize> = (0..vectors.len()).filter(|&k| !known(&vectors[k])).collect();
        for _ in 0..3 {
            let before = vectors.clone();
            for &k in unknown.iter().filter(|&&k| !known(&before[k])) {
                let (y, x) = (k / width, k % width);
                let (mut sum, mut count) = ([0.0f32; 2], 0.0f32);
                for row in y.saturating_sub(1)..(y + 2).min(height) {
                    for near in &before[row * width..][x.saturating_sub(1)..(x + 2).min(width)] {
                        if known(near) {
                            sum = [sum[0] + near[0], sum[1] + near[1]];
                            count += 1.0;
                        }
                    }
                }
                if count > 0.0 {
                    vectors[k] = [sum[0] / count, sum[1] / count];
                }
            }
        }
        for k in unknown {
            if !known(&vectors[k]) {
                vectors[k] = [0.0; 2];
            }
        }
        MotionField { vectors, size }
    }

    /// Motion of the image part that is at each sample when its row is exposed, of `height` rows:
    /// with v at one instant, `from + v(from) late = here`.
    pub fn at_readout(self, shutter: Shutter, height: usize) -> Self {
        if shutter.readout == 0.0 {
            return self;
        }
        let columns = self.size.1;
        let mut vectors = vec![[0.0; 2]; self.vectors.len()];
        vectors.par_chunks_mut(LINES * columns).enumerate().for_each(|(group, lines)| {
            for (k, line) in lines.chunks_exact_mut(columns).enumerate() {
                let row = group * LINES + k;
                read_out_line(&self, row, shutter.window(place(row), height).late, line);
            }
        });
        MotionField { vectors, ..self }
    }

    /// The four vectors around a position, given the first's row and column.
    #[inline(always)]
    fn about(&self, row: usize, column: usize) -> [[f32; 2]; 4] {
        let (rows, columns) = self.size;
        let (right, below) = ((column + 1).min(columns - 1), (row + 1).min(rows - 1) * columns);
        let row = row * columns;
        [row + column, row + right, below + column, below + right].map(|k| self.vectors[k])
    }

    /// Vectors of all pixels of one row: columns, then rows.
    #[inline(always)]
    pub fn row(&self, y: usize, width: usize) -> [Vec<f32>; 2] {
        let (rows, columns) = self.size;
        let (first, t) = between(y as f32, rows);
        let line = |r: usize| &self.vectors[r * columns..(r + 1) * columns];
        let (above, below) = (line(first), line((first + 1).min(rows - 1)));
        let mut all = [0; 2].map(|_| vec![0.0; width.max(STEP / 2 + columns * STEP)]);
        for (k, all) in all.iter_mut().enumerate() {
            let known = |c: usize| mix(above[c][k], below[c][k], t);
            let mut last = known(0);
            let (before, squares) = all.split_at_mut(STEP / 2);
            before.fill(last);
            let squares = squares.as_chunks_mut::<STEP>().0;
            for (column, square) in squares.iter_mut().take(columns).enumerate() {
                let next = known((column + 1).min(columns - 1));
                let slope = (next - last) / STEP as f32;
                *square = std::array::from_fn(|i| last + slope * i as f32);
                last = next;
            }
            all[STEP / 2 + columns * STEP..].fill(last);
        }
        all
    }
}

/// Motion at a row of samples of the image parts that are there after a delay.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn read_out_line(field: &MotionField, row: usize, late: f32, line: &mut [[f32; 2]]) {
    let (rows, columns) = field.size;
    let own = &field.vectors[row * columns..][..columns];
    for (number, (line, own)) in line.chunks_mut(RUN).zip(own.chunks(RUN)).enumerate() {
        let mut v = [[0.0f32; RUN]; 2];
        for (i, own) in own.iter().enumerate() {
            (v[0][i], v[1][i]) = (own[0], own[1]);
        }
        for _ in 0..FIXED_POINT_STEPS {
            let (mut first, mut weight) = ([[0; RUN]; 2], [[0.0f32; RUN]; 2]);
            for i in 0..RUN {
                let x = place(number * RUN + i) - v[0][i] * late;
                (first[0][i], weight[0][i]) = between(x, columns);
                (first[1][i], weight[1][i]) = between(place(row) - v[1][i] * late, rows);
            }
            let mut about = [[[0.0f32; RUN]; 4]; 2];
            for i in 0..line.len() {
                for (n, vector) in field.about(first[1][i], first[0][i]).into_iter().enumerate() {
                    (about[0][n][i], about[1][n][i]) = (vector[0], vector[1]);
                }
            }
            let mut change = 0.0;
            for (v, [a, b, c, d]) in v.iter_mut().zip(&about) {
                for i in 0..RUN {
                    let (above, below) =
                        (mix(a[i], b[i], weight[0][i]), mix(c[i], d[i], weight[0][i]));
                    let found = mix(above, below, weight[1][i]);
                    change = max((found - v[i]).abs(), change);
                    v[i] = found;
                }
            }
            if change < SETTLED {
                break;
            }
        }
        for (i, out) in line.iter_mut().enumerate() {
            *out = [v[0][i], v[1][i]];
        }
    }
}

/// Pixel of a sample along an axis.
#[inline(always)]
fn place(number: usize) -> f32 {
    (number * STEP + STEP / 2) as f32
}

/// Index of the sample before a position [px], and the fraction of the distance to the next.
#[inline(always)]
fn between(place: f32, count: usize) -> (usize, f32) {
    let number = (place - (STEP / 2) as f32) / STEP as f32;
    whole(clamp(number, 0.0, count as f32 - 1.0))
}

/// Exposure of rows and LED pulse, in fractions of a frame's time.
#[derive(Clone, Copy)]
pub struct Shutter {
    /// Exposure time of each row.
    pub open: f32,
    /// Time from the center of the first row's exposure to that of the last row's; the exposure of
    /// the middle row is centered on the instant of the image.
    pub readout: f32,
    /// Duration of the LED pulse around that instant.
    pub pulse: f32,
}

/// Time in which a row receives light.
#[derive(Clone, Copy)]
pub struct Window {
    /// Center of that time relative to the instant of the image, and its length.
    pub late: f32,
    pub length: f32,
    /// Fraction of the light of a row that is exposed during the whole pulse.
    pub weight: f32,
}

impl Shutter {
    /// Creates a shutter from the three times in order.
    pub fn of((open, readout, pulse): (f32, f32, f32)) -> Self {
        Shutter { open, readout, pulse }
    }

    /// Window of a row among `height`.
    pub fn window(&self, row: f32, height: usize) -> Window {
        let middle = self.readout * ((row + 0.5) / height as f32 - 0.5);
        let (half, lit) = (0.5 * self.open, 0.5 * self.pulse);
        let (first, last) = (max(middle - half, -lit), min(middle + half, lit));
        if first == middle - half && last == middle + half {
            return Window { late: middle, length: self.open, weight: 1.0 };
        }
        let length = max(last - first, 0.0);
        let weight = length / min(self.open, self.pulse);
        Window {
            late: 0.5 * (first + last),
            length,
            weight: if length > 0.0 { weight } else { 0.0 },
        }
    }
}

#[inline(always)]
fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// Integer and fractional part of a value from 0 to 2²².
#[inline(always)]
pub fn whole(x: f32) -> (usize, f32) {
    // Adding 1.5 · 2²³ rounds to an integer and leaves it in the low bits.
    let shifted = (x - 0.5) + 12_582_912.0;
    ((shifted.to_bits() & 0x003f_ffff) as usize, x - (shifted - 12_582_912.0))
}
