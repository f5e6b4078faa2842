//! Villi: gaps between those seen from above, and a fringe of those at the outlines of folds.
//!
//! The wall of the scene ends at the bases of the villi. Seen from above, the gaps between them are a
//! dark network, deeper in strokes, in more detail than a texture of a whole gut could hold; where
//! pixels do not resolve them, fainter and wider strokes between tufts of villi are drawn. Seen
//! aslant, a ray passes several villi, so that gaps are streaks along the slope. Along an
//! outline villi are seen from the side: a pixel behind it within the length of a villus takes the
//! radiance of the wall at the nearest pixel of the outline, and is shaded between villi. Gaps and
//! lengths are fixed to one shape of the wall, so villi stay in their places while the wall moves.
//! Only radiance changes; depth and labels are those of the wall.

mod outlines;

use crate::mucosa::noise::{Cells, DEVIATION, Lattice, Vec3, exp, smoothstep};
use crate::mucosa::strokes::{LEAF, Strokes, leaf_space};
use crate::pool::on_pool;
use crate::render::diffusion::Points;
use crate::simd::f32x64::{LANES, Lane, Lane3, at, clamp, dot, max, min};
use numpy::ndarray::{ArrayView2, ArrayViewMut3, Axis};
use numpy::{PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;
use std::ops::Range;

/// Seeds of the cells, and of the variation of the lengths, of the gaps and of their density.
const SEEDS: [u32; 4] = [0x7669_6c6c, 0x7669_6c68, 0x7669_6c67, 0x7669_6c70];
/// Size of patches of like density of gaps [m], standard deviation of the density over them relative
/// to its mean, and the range of this ratio; chosen by eye. Mucus fills gaps in places, and villi lie
/// flat in others.
const PATCH: f32 = 5e-3;
const PATCHINESS: f32 = 0.4;
const DENSITIES: [f32; 2] = [0.1, 2.5];
/// Pixels across villi, or tufts, below which gaps are invisible, and from which they are drawn fully.
const RESOLVED: [f32; 2] = [1.2, 2.5];
/// Size of tufts relative to villi, and density of the gaps between them relative to those between
/// villi; by eye.
const TUFT_SIZE: f32 = 1.6;
const TUFT_GAPS: f32 = 0.35;
/// Pixels across villi from which, and up to which, gaps fade to `PRESSED` of their density: villi so
/// near to the camera lie against the dome, which closes the gaps between them.
const NEAR: [f32; 2] = [4.0, 8.0];
const PRESSED: f32 = 0.4;
/// Ratio of the sides of a pixel on that shape of the wall up to which gaps are invisible, and from
/// which they are drawn fully: where a wall is gathered or pulled, gaps would be streaks.
const ROUND: [f32; 2] = [0.2, 0.4];
/// Spacing of the lattice of strokes [spacings of villi].
const STROKES: f32 = 0.9;
/// Part of the gaps that surrounds each villus in a wall that faces the camera; the rest are strokes,
/// and all are in one seen edge-on.
const AROUND: f32 = 0.5;
/// Difference of the distances to the nearest two centers at which the gap around a villus ends
/// [cells], and the mean depth of such gaps.
const GAP: f32 = 0.45;
const MEAN_GAP: f32 = 0.59;
/// Relative density of gaps in a wall that faces the camera and in one seen edge-on: the LEDs are next
/// to the camera and light the ground of the former, by assumption, and streaks of the latter are means
/// of several gaps, which have less contrast.
const FACING: f32 = 0.63;
const ASLANT: f32 = 1.4;
/// Visible length of a villus relative to its width, by assumption: a ray that meets the wall at an
/// angle θ to the normal passes over this length times tan θ, of which `STEEPEST` is the maximum.
const LEAN: f32 = 2.5;
const STEEPEST: f32 = 2.0;
/// Optical density of a gap in red, green and blue relative to green.
const GAP_COLOR: [f32; 3] = [0.45, 1.0, 1.1];

/// Channels of an image: distance along each ray [h w] in meters, NaN where there is no surface;
/// face [h w], negative there; weights of its first two corners [h w 2]; label [h w]; and label of
/// the foreground [h w], 0 where nothing is in front of the wall.
pub type GivenSeen<'py> = (
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray2<'py, i32>,
    PyReadonlyArray3<'py, f32>,
    PyReadonlyArray2<'py, u8>,
    PyReadonlyArray2<'py, u8>,
);

/// `GivenSeen`, as used by the core.
struct Seen<'a> {
    size: (usize, usize),
    /// Distance along each ray [m], NaN where there is no surface.
    distance: &'a [f32],
    face: &'a [i32],
    /// Weights of the first and second corner of the face.
    weights: &'a [f32],
    /// Label of the foreground, 0 for none.
    hidden: &'a [u8],
    /// Mean length of the villi that stands out [m], 0 for none.
    length: Vec<f32>,
    /// Optical density of the gaps between villi, 0 for none.
    gaps: Vec<f32>,
}

/// Draws villi into planes [3 h w], in place.
///
/// `by_label` [2 256] are the lengths of villi [m] and the densities of the gaps between them;
/// `wall` are vertices [n 3] and faces [m 3] of the wall at the width at which villi have their
/// shape; `tissue` are the root of the area per villus [m], and the standard deviations along an axis
/// of the diffusion of red, green and blue light [m]; `focal` are the pixels per radian.
///
/// # Errors
/// If arrays differ in size, or a face or vertex does not exist.
#[pyfunction]
pub fn raise_villi(
    py: Python<'_>,
    mut planes: PyReadwriteArray3<'_, f32>,
    seen: GivenSeen<'_>,
    wall: (PyReadonlyArray2<'_, f64>, PyReadonlyArray2<'_, i64>),
    by_label: [[f32; 256]; 2],
    tissue: (f32, [f32; 3]),
    focal: f32,
) -> PyResult<()> {
    let (seen, (spacing, diffusion)) = (Seen::of(&seen, &by_label)?, tissue);
    if planes.shape() != [3, seen.size.0, seen.size.1] {
        return Err(PyValueError::new_err("Planes must be of the channels' size (3, h, w)."));
    }
    if !(spacing > 0.0 && focal > 0.0) {
        return Err(PyValueError::new_err("Spacing and focal length must be above 0."));
    }
    let (mut image, vertices, faces) =
        (planes.as_array_mut(), wall.0.as_array(), wall.1.as_array());
    on_pool(py, || {
        let places = seen.places(vertices, faces)?;
        seen.diffuse(&mut image, diffusion, focal);
        seen.shade(&places, &mut image, spacing, focal);
        let outlines = seen.outlines();
        seen.round(&outlines, &mut image, focal);
        seen.paint(&seen.grow(&outlines, &places, spacing, focal), &mut image);
        Ok(())
    })
}

impl<'a> Seen<'a> {
    /// Surfaces, given the lengths of villi by label.
    fn of(given: &'a GivenSeen<'_>, by_label: &[[f32; 256]; 2]) -> PyResult<Self> {
        let (distance, face, weights, label, hidden) = given;
        let [rows, columns] = distance.shape()[..] else { unreachable!("two dimensions") };
        let fits = face.shape() == [rows, columns]
            && weights.shape() == [rows, columns, 2]
            && label.shape() == [rows, columns]
            && hidden.shape() == [rows, columns];
        if !fits {
            return Err(PyValueError::new_err("Channels must be of one size (h, w)."));
        }
        let label = label.as_slice()?;
        let [length, gaps] = by_label
            .each_ref()
            .map(|values| label.iter().map(|&label| values[usize::from(label)]).collect());
        let (distance, face) = (distance.as_slice()?, face.as_slice()?);
        let (weights, hidden) = (weights.as_slice()?, hidden.as_slice()?);
        Ok(Seen { size: (rows, columns), distance, face, weights, hidden, length, gaps })
    }

    /// Positions of pixels on the given shape of the wall [m]; NaN where there are no villi.
    fn places(
        &self,
        vertices: ArrayView2<'_, f64>,
        faces: ArrayView2<'_, i64>,
    ) -> PyResult<Vec<Vec3>> {
        let missing = || PyValueError::new_err("A face or vertex does not exist.");
        let place = |pixel: usize| {
            if !self.has_villi(pixel) {
                return Ok([f32::NAN; 3]);
            }
            let face = usize::try_from(self.face[pixel]).ok().filter(|&face| face < faces.nrows());
            let corners = faces.row(face.ok_or_else(missing)?);
            let [first, second] = [self.weights[2 * pixel], self.weights[2 * pixel + 1]];
            let mut place = [0.0; 3];
            for (corner, weight) in corners.iter().zip([first, second, 1.0 - first - second]) {
                let vertex = usize::try_from(*corner).ok().filter(|&v| v < vertices.nrows());
                let vertex = vertices.row(vertex.ok_or_else(missing)?);
                for k in 0..3 {
                    place[k] += weight * vertex[k] as f32;
                }
            }
            Ok(place)
        };
        (0..self.face.len()).into_par_iter().map(place).collect()
    }

    /// Check that a pixel shows wall with villi and nothing in front of it.
    fn has_villi(&self, pixel: usize) -> bool {
        self.length[pixel] + self.gaps[pixel] > 0.0
            && self.face[pixel] >= 0
            && self.hidden[pixel] == 0
    }

    /// Diffuses light in the tissue below villi.
    fn diffuse(&self, planes: &mut ArrayViewMut3<'_, f32>, deviations: [f32; 3], focal: f32) {
        if deviations == [0.0; 3] {
            return;
        }
        let own = |(pixel, &distance)| if self.has_villi(pixel) { distance } else { f32::NAN };
        let distance: Vec<f32> =
            self.distance.par_iter().enumerate().with_min_len(4096).map(own).collect();
        Points { size: self.size, distance: &distance, focal }.diffuse(planes, deviations);
    }

    /// Darkens the gaps between villi that are seen from above.
    fn shade(
        &self,
        places: &[Vec3],
        planes: &mut ArrayViewMut3<'_, f32>,
        spacing: f32,
        focal: f32,
    ) {
        let width = width(spacing);
        let strokes = [1.0, TUFT_SIZE]
            .map(|size| Strokes::new(Lattice::new(SEEDS[2], STROKES * size * spacing)));
        let cells = Cells::new(SEEDS[0], spacing);
        let patches = Lattice::new(SEEDS[3], PATCH);
        let columns = self.size.1;
        let mut lines: Vec<_> = planes.axis_iter_mut(Axis(1)).collect();
        lines.par_iter_mut().enumerate().for_each(|(y, line)| {
            for start in (0..columns).step_by(LANES) {
                let pixels = y * columns + start..y * columns + columns.min(start + LANES);
                let gaps = gaps(self, places, pixels, width, focal);
                if gaps.weights.as_flattened().iter().all(|&weight| weight <= 0.0) {
                    continue;
                }
                let remaining = remaining(&strokes, &cells, &patches, &gaps);
                for i in 0..LANES.min(columns - start) {
                    for k in 0..3 {
                        line[[k, start + i]] *= remaining[k][i];
                    }
                }
            }
        });
    }
}

/// Gaps at up to `LANES` pixels of a row.
struct Gaps {
    /// Weights of the gaps between villi, and between tufts of them, 0 where none are drawn.
    weights: [Lane; 2],
    /// Part of the gaps between villi that surrounds each of them.
    around: Lane,
    /// Positions [m].
    places: Lane3,
    /// Third of the displacement along the wall over which a ray passes villi [m].
    leans: Lane3,
}

/// Gaps between villi of a width at up to `LANES` pixels of a row.
///
/// Gaps are drawn if pixels resolve them, less next to the dome, and where the wall is seen aslant:
/// by the squared sine of the angle between the ray and its normal.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn gaps(seen: &Seen<'_>, places: &[Vec3], pixels: Range<usize>, width: f32, focal: f32) -> Gaps {
    let (mut own, mut right, mut down) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3], [[0.0; LANES]; 3]);
    let (mut distance, mut rises) = ([0.0; LANES], [[0.0; LANES]; 2]);
    let mut densities = [0.0; LANES];
    for (i, pixel) in pixels.enumerate() {
        (densities[i], distance[i]) = (seen.gaps[pixel], seen.distance[pixel]);
        for (next, step, rise) in [(pixel + 1, &mut right, 0), (pixel + seen.size.1, &mut down, 1)]
        {
            let beside = places.get(next).map_or([f32::NAN; 3], |&place| place);
            for k in 0..3 {
                step[k][i] = beside[k] - places[pixel][k];
            }
            rises[rise][i] = seen.distance.get(next).map_or(0.0, |&next| next - distance[i]);
        }
        for k in 0..3 {
            own[k][i] = places[pixel][k];
        }
    }
    let (mut weights, mut leans) = ([[0.0; LANES]; 2], [[0.0; LANES]; 3]);
    let mut around = [0.0; LANES];
    for i in 0..LANES {
        let (right, down) = (at(&right, i), at(&down, i));
        let (across, along) = (dot(right, right), dot(down, down));
        let (widest, product) = (max(across, along), dot(right, down));
        let area = max(across * along - product * product, 0.0).sqrt();
        let resolved = width / widest.sqrt();
        let open = 1.0 - (1.0 - PRESSED) * smoothstep(NEAR[0], NEAR[1], resolved);
        let round = smoothstep(ROUND[0], ROUND[1], area / widest);
        let [single, tuft] =
            [1.0, TUFT_SIZE].map(|size| smoothstep(RESOLVED[0], RESOLVED[1], resolved * size));
        let [rise_right, rise_down] = [0, 1].map(|k| rises[k][i] / distance[i]);
        let square = (rise_right * rise_right + rise_down * rise_down) * focal * focal;
        let slant = if square.is_nan() { 0.0 } else { square / (1.0 + square) };
        let slope = [0, 1, 2].map(|k| rise_right * right[k] + rise_down * down[k]);
        let reach = LEAN * width * min(square.sqrt(), STEEPEST);
        let lean = reach / (3.0 * max(dot(slope, slope), 1e-30).sqrt());
        let weight = densities[i] * open * round * (FACING + (ASLANT - FACING) * slant);
        let is_drawn = !(across + along).is_nan() & (widest > 0.0) & (weight * tuft > 0.0);
        let weight = if is_drawn { weight } else { 0.0 };
        weights[0][i] = weight * single;
        weights[1][i] = weight * TUFT_GAPS * tuft * (1.0 - single);
        around[i] = AROUND * (1.0 - slant);
        for k in 0..3 {
            own[k][i] = if is_drawn { own[k][i] } else { 0.0 };
            leans[k][i] = if is_drawn && slant > 0.0 { lean * slope[k] } else { 0.0 };
        }
    }
    Gaps { weights, around, places: own, leans }
}

/// Fraction of the light at pixels that gaps between villi and tufts leave, by color; gaps without
/// weight at all pixels are not computed.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn remaining(strokes: &[Strokes; 2], cells: &Cells, patches: &Lattice, gaps: &Gaps) -> Lane3 {
    let Gaps { weights, around, places, .. } = gaps;
    let (mut depths, mut borders, mut tufts) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    if weights[0] != [0.0; LANES] {
        depths = gaps.mean(&strokes[0]);
        borders = cells.borders(&leaf_space(places, LEAF));
    }
    if weights[1] != [0.0; LANES] {
        tufts = gaps.mean(&strokes[1]);
    }
    let patches = patches.gradients(places);
    let mut remaining = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let border = 1.0 - smoothstep(0.0, GAP, borders[i]) - MEAN_GAP;
        let patch = 1.0 + PATCHINESS / DEVIATION * patches[i];
        let single = weights[0][i] * (depths[i] + around[i] * (border - depths[i]));
        let density =
            (single + weights[1][i] * tufts[i]) * clamp(patch, DENSITIES[0], DENSITIES[1]);
        for k in 0..3 {
            remaining[k][i] = exp(-GAP_COLOR[k] * density);
        }
    }
    remaining
}

impl Gaps {
    /// Mean depth of strokes over the villi that each ray passes.
    #[inline(always)]
    fn mean(&self, strokes: &Strokes) -> Lane {
        let mut sum = strokes.depths(&self.places);
        for sign in [-1.0, 1.0] {
            let mut places = self.places;
            for (along, leans) in places.iter_mut().zip(&self.leans) {
                for i in 0..LANES {
                    along[i] += sign * leans[i];
                }
            }
            let depths = strokes.depths(&places);
            for i in 0..LANES {
                sum[i] += depths[i];
            }
        }
        sum.map(|sum| sum / 3.0)
    }
}

/// Width of a villus, a leaf `LEAF` times as long as wide, given the root of the area per villus [m].
fn width(spacing: f32) -> f32 {
    spacing / LEAF.sqrt()
}
