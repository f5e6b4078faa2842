//! Visibility of points on the wall from one point: shadows and occlusion.

use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MISS, Pyramid, trace};
use rayon::prelude::*;

/// Fraction of the distance that must be unoccluded: the point itself lies on the wall.
pub const SHADOW_REACH: f32 = 1.0 - 1e-4;

/// Unit directions from `origin` to each of a tile's points, and the distances along them that must
/// be unoccluded [m]: 0 in lanes not `used`.
#[inline(always)]
pub fn shadow_segments(origin: Vec3, points: &Lane3, used: &[bool; LANES]) -> (Lane3, Lane) {
    let (mut directions, mut reach) = ([[0.0; LANES]; 3], [0.0; LANES]);
    for i in 0..LANES {
        let offset = sub(at(points, i), origin);
        let distance = dot(offset, offset).sqrt();
        let inverse = if distance > 0.0 { 1.0 / distance } else { 0.0 };
        for k in 0..3 {
            directions[k][i] = offset[k] * inverse;
        }
        reach[i] = if used[i] { distance * SHADOW_REACH } else { 0.0 };
    }
    (directions, reach)
}

/// `true` where the segment from `origin` to a point of a tile is unoccluded and its lane `used`.
#[inline(always)]
pub fn visible_tile(
    wall: &Wall,
    origin: Vec3,
    points: &Lane3,
    used: &[bool; LANES],
) -> [bool; LANES] {
    let (directions, reach) = shadow_segments(origin, points, used);
    let pyramid = Pyramid::around(directions, used);
    let mut hits = Hits::within(reach);
    trace::<true>(&wall.bvh, origin, &pyramid, wall.extent, &mut hits);
    let mut result = [false; LANES];
    for i in 0..LANES {
        result[i] = used[i] & (hits.triangle[i] == MISS);
    }
    result
}

/// `true` where the segment from `origin` to a point is unoccluded; false for points with NaN.
pub fn visible(wall: &Wall, origin: Vec3, points: &[Vec3]) -> Vec<bool> {
    let mut result = vec![false; points.len()];
    result.par_chunks_mut(LANES).zip(points.par_chunks(LANES)).for_each(|(out, chunk)| {
        let (mut lanes, mut used) = ([[0.0; LANES]; 3], [false; LANES]);
        for (i, point) in chunk.iter().enumerate() {
            used[i] = point.iter().all(|x| x.is_finite());
            for k in 0..3 {
                lanes[k][i] = if used[i] { point[k] } else { origin[k] };
            }
        }
        out.copy_from_slice(&visible_chunk(wall, origin, &lanes, &used)[..chunk.len()]);
    });
    result
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn visible_chunk(wall: &Wall, origin: Vec3, points: &Lane3, used: &[bool; LANES]) -> [bool; LANES] {
    visible_tile(wall, origin, points, used)
}
