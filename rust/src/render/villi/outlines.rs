//! Outlines of folds: edges as if they were round, and villi seen from the side.

use super::{SEEDS, Seen, width};
use crate::mucosa::noise::{Cells, DEVIATION, Lattice, Vec3, exp, smoothstep};
use crate::mucosa::strokes::{LEAF, leaf_space};
use crate::simd::f32x64::{LANES, clamp, max, min};
use numpy::ndarray::ArrayViewMut3;
use rayon::prelude::*;
use std::ops::Range;

/// Difference of distances along adjacent rays at an outline [m].
const STEP: f32 = 1.0e-3;
/// Maximum angle over which a villus is drawn [rad]; those next to the dome are out of focus.
const WIDEST: f32 = 0.11;
/// Distance from the outline to the wall whose radiance villi take [px].
const INWARD: f32 = 1.5;
/// Radius of curvature of the edges of folds, which the mesh is too coarse to have [m], by assumption,
/// and its maximum in the image [px].
const EDGE: f32 = 1.0e-3;
const WIDEST_EDGE: f32 = 12.0;
/// Difference of distances at an outline from which it is the edge of a fold before an open lumen [m];
/// below, folds are in contact.
const EDGE_STEP: f32 = 3.0e-3;
/// Optical density of an edge that is edge-on, in red, green and blue: less in red, as tissue lets it
/// through. The normals of the mesh contribute the rest. By eye.
const EDGE_COLOR: [f32; 3] = [0.38, 0.51, 0.55];
/// Pixels along villi up to which a fringe is a soft band, and from which its villi stand out.
const FRINGE: [f32; 2] = [1.5, 3.5];
/// Length over which the tip of a villus ends [px].
const TIP: f32 = 1.5;
/// Maximum weight of single villi in a fringe; the rest is its mean over villi of all lengths.
const SINGLE: f32 = 0.9;
/// Fraction of the light that villi take from the wall behind them, at their ground, and pixels along
/// villi up to which they take none, and from which they take all of it; by eye.
const SHADE: f32 = 0.5;
const SHADING: [f32; 2] = [2.0, 7.0];
/// Opacity of villi that stand out between folds in contact, and fraction of the shade that is absent
/// in places, which have the size `PLACE` [m]; by eye.
const IN_CONTACT: f32 = 0.4;
const UNEVEN: f32 = 0.8;
const PLACE: f32 = 2.5e-3;
/// Minimum width of what stands out [px]: narrower villi stick together in tufts.
const TUFT: f32 = 5.0;
/// Widths of tufts relative to those of villi.
const TUFTS: [f32; 3] = [1.0, 2.0, 4.0];
/// Relative length in the gaps between villi, and difference of the distances to the nearest two
/// centers at which a villus has its full length [cells].
const GROUND: f32 = 0.5;
const SHOULDER: f32 = 0.55;
/// Relative standard deviation of the lengths.
const SPREAD: f32 = 0.25 / DEVIATION;
/// Maximum length relative to the mean.
const TALLEST: f32 = 1.5;

/// Pixel of an outline.
pub struct Outline {
    pixel: usize,
    /// Length of its villus in the image [px].
    length: f32,
    /// Length of the tallest villus there [px].
    longest: f32,
    /// Position between the gap next to the villus (0) and its middle (1).
    middle: f32,
    /// Weight of single villi in the fringe; the rest is its mean over villi of all lengths.
    sharp: f32,
    /// Fraction of the light that it takes from the wall behind, at its ground.
    shade: f32,
    /// Opacity at its ground.
    opacity: f32,
}

impl Seen<'_> {
    /// Pixels next to a ray that passes the wall's outline.
    pub fn outlines(&self) -> Vec<usize> {
        let (rows, columns) = self.size;
        let is_outline = |&pixel: &usize| {
            let has_fringe = self.length[pixel] > 0.0 && self.has_villi(pixel);
            has_fringe && self.step(pixel) > STEP
        };
        let inside = |y: usize| y * columns + 1..(y + 1) * columns - 1;
        let rows = (1..rows.saturating_sub(1)).into_par_iter();
        rows.flat_map_iter(|y| inside(y).filter(is_outline)).collect()
    }

    /// Maximum difference between the distances of the pixels around one inside the image and its own
    /// [m].
    fn step(&self, pixel: usize) -> f32 {
        let around = [pixel - self.size.1, pixel - 1, pixel + 1, pixel + self.size.1];
        around.iter().fold(0.0, |step, &next| max(self.distance[next] - self.distance[pixel], step))
    }

    /// Degree to which an outline is the edge of a fold before an open lumen, 0 for folds in contact.
    fn openness(&self, pixel: usize) -> f32 {
        smoothstep(STEP, EDGE_STEP, self.step(pixel))
    }

    /// Villi of the pixels of outlines.
    pub fn grow(
        &self,
        pixels: &[usize],
        places: &[Vec3],
        spacing: f32,
        focal: f32,
    ) -> Vec<Outline> {
        let tufts = TUFTS.map(|size| Cells::new(SEEDS[0], size * spacing));
        let lengths = Lattice::new(SEEDS[1], 1.5 * spacing);
        let shaded = Lattice::new(SEEDS[3], PLACE);
        let mut outlines = Vec::with_capacity(pixels.len());
        for pixels in pixels.chunks(LANES) {
            let mut lanes = [[0.0; LANES]; 3];
            for (i, &pixel) in pixels.iter().enumerate() {
                for k in 0..3 {
                    lanes[k][i] = places[pixel][k];
                }
            }
            let space = leaf_space(&lanes, LEAF);
            let borders = tufts.each_ref().map(|cells| cells.borders(&space));
            for (i, &pixel) in pixels.iter().enumerate() {
                let place = places[pixel];
                let per_length = focal / self.distance[pixel];
                let ((below, above), share) = tuft_level(width(spacing) * per_length);
                let middle = [below, above].map(|k| min(borders[k][i] / SHOULDER, 1.0).sqrt());
                let middle = middle[0] + share * (middle[1] - middle[0]);
                let varied = clamp(1.0 + SPREAD * lengths.gradient(place), 0.3, TALLEST);
                let profile = GROUND + (1.0 - GROUND) * middle;
                let mean = min(self.length[pixel] * per_length, WIDEST / TALLEST * focal);
                let (length, longest) = (mean * varied * profile, mean * TALLEST);
                let sharp = SINGLE * smoothstep(FRINGE[0], FRINGE[1], mean);
                let open = self.openness(pixel);
                let even = 1.0 - UNEVEN * clamp(0.4 - 0.6 * shaded.gradient(place), 0.0, 1.0);
                let shade = SHADE * smoothstep(SHADING[0], SHADING[1], mean) * open * even;
                let opacity = IN_CONTACT + (1.0 - IN_CONTACT) * open;
                outlines.push(Outline { pixel, length, longest, middle, sharp, shade, opacity });
            }
        }
        outlines
    }

    /// Darkens the wall towards outlines as if the edges of folds were round: the LEDs are next to the
    /// camera, so that the light of a wall falls as the cosine between its normal and the ray does.
    pub fn round(&self, outlines: &[usize], planes: &mut ArrayViewMut3<'_, f32>, focal: f32) {
        let columns = self.size.1;
        let radius = |pixel: usize| min(EDGE * focal / self.distance[pixel], WIDEST_EDGE);
        let around = |&pixel: &usize| {
            let distance = self.distance[pixel];
            (pixel, radius(pixel), distance - EDGE_STEP..distance + 0.5 * STEP)
        };
        for (pixel, outline, apart) in self.nearest(outlines.iter().map(around)) {
            if !self.has_villi(pixel) {
                continue;
            }
            let base = outlines[outline];
            let inward = 1.0 - min((apart + 0.5) / radius(base), 1.0);
            let density = (1.0 - (1.0 - inward * inward).sqrt()) * self.openness(base);
            for k in 0..3 {
                planes[[k, pixel / columns, pixel % columns]] *= exp(-EDGE_COLOR[k] * density);
            }
        }
    }

    /// Draws villi, each over the pixels behind that are nearest to its outline, and shades those
    /// between them.
    pub fn paint(&self, outlines: &[Outline], planes: &mut ArrayViewMut3<'_, f32>) {
        let columns = self.size.1;
        let color = |pixel: usize, planes: &ArrayViewMut3<'_, f32>| {
            [0, 1, 2].map(|k| planes[[k, pixel / columns, pixel % columns]])
        };
        let mut drawn = Vec::new();
        let beyond = |outline: &Outline| {
            let distance = self.distance[outline.pixel];
            (outline.pixel, outline.longest, distance + 0.5 * STEP..f32::INFINITY)
        };
        for (pixel, outline, apart) in self.nearest(outlines.iter().map(beyond)) {
            let Outline { pixel: base, length, longest, middle, sharp, shade, opacity } =
                outlines[outline];
            let mix = |mean: f32, single: f32| mean + sharp * (single - mean);
            let mean = clamp(1.0 - apart / longest, 0.0, 1.0);
            let covered = mix(mean, clamp((length - apart) / TIP + 0.5, 0.0, 1.0));
            if covered <= 0.0 {
                continue;
            }
            // Tips let light through.
            let (along, middle) = (min(apart / mix(longest, length), 1.0), mix(0.5, middle));
            let (opacity, tone) = (
                opacity * covered * (1.0 - 0.35 * along),
                (0.7 + 0.2 * middle) * (1.0 - 0.2 * along),
            );
            let villus = color(self.inside(base, pixel, apart), planes).map(|x| x * tone);
            let behind = color(pixel, planes).map(|x| x * (1.0 - shade * mean));
            drawn.push((pixel, [0, 1, 2].map(|k| behind[k] + opacity * (villus[k] - behind[k]))));
        }
        for (pixel, villus) in drawn {
            for k in 0..3 {
                planes[[k, pixel / columns, pixel % columns]] = villus[k];
            }
        }
    }

    /// Pixels around outlines, the index of the nearest outline of each, and the distance to it [px],
    /// given the pixel of each outline, a maximum distance and a range of distances along rays [m].
    fn nearest(
        &self,
        outlines: impl Iterator<Item = (usize, f32, Range<f32>)>,
    ) -> Vec<(usize, usize, f32)> {
        let (rows, columns) = self.size;
        let outlines: Vec<_> = outlines.collect();
        let mut nearest = vec![(usize::MAX, 0); rows * columns];
        nearest.par_chunks_mut(columns.max(1)).enumerate().for_each(|(row, nearest)| {
            let pixels = row * columns..(row + 1) * columns;
            let (distance, hidden) = (&self.distance[pixels.clone()], &self.hidden[pixels]);
            for (k, (outline, reach, range)) in outlines.iter().enumerate() {
                let reach = (reach + 1.0) as usize;
                let (y, x) = (outline / columns, outline % columns);
                if row.abs_diff(y) > reach {
                    continue;
                }
                for column in x.saturating_sub(reach)..=(x + reach).min(columns - 1) {
                    let square = row.abs_diff(y).pow(2) + column.abs_diff(x).pow(2);
                    let is_nearer = square < nearest[column].0;
                    if is_nearer && hidden[column] == 0 && range.contains(&distance[column]) {
                        nearest[column] = (square, k);
                    }
                }
            }
        });
        let within = |(pixel, &(square, k)): (usize, &(usize, usize))| {
            (square < usize::MAX).then(|| (pixel, k, (square as f32).sqrt()))
        };
        nearest.iter().enumerate().filter_map(within).collect()
    }

    /// Pixel of the wall inside of an outline, on the other side than a pixel behind it.
    fn inside(&self, base: usize, behind: usize, apart: f32) -> usize {
        let (rows, columns) = self.size;
        let step = |from: usize, to: usize, size: usize| {
            let offset = INWARD * (from as f32 - to as f32) / max(apart, 1.0);
            clamp(from as f32 + offset + 0.5, 0.0, size as f32 - 1.0) as usize
        };
        let (y, x) = (base / columns, base % columns);
        let inside = step(y, behind / columns, rows) * columns + step(x, behind % columns, columns);
        let is_same = (self.distance[inside] - self.distance[base]).abs() < 1.5 * STEP;
        if is_same { inside } else { base }
    }
}

/// Tufts next to the size at which they stand out, given the pixels across a villus: indices of the
/// smaller and the larger in `TUFTS`, and the weight of the larger.
fn tuft_level(pixels: f32) -> ((usize, usize), f32) {
    let level = clamp((TUFT / pixels).log2(), 0.0, TUFTS.len() as f32 - 1.0);
    let below = (level as usize).min(TUFTS.len() - 2);
    ((below, below + 1), level - below as f32)
}
