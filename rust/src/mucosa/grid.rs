//! Spatial grid of vessel segments, and the blood visible at a point.

use super::noise::{exp, floor};
use super::vessels::Segment;
use crate::simd::f32x64::{LANES, Lane, Lane3, Vec3, at, clamp, dot, max, scale, sub};
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::Range;

/// Edge of a cell [mm].
const CELL: f32 = 1.0;

/// Maximum width of a texel that blurs vessels [mm].
const MAX_FOOTPRINT: f32 = 0.3;

/// Absorption of whole blood in green light [1/mm], about 25 at 550 nm and less over a camera's
/// broad band (Bosschaart et al., Lasers Med Sci 29:453, 2014).
const BLOOD_ABSORPTION: f32 = 25.0;

/// Fraction of green light that blood in arteries and in veins absorbs, at the points of a lane.
pub struct Blood {
    /// Absorption by arteries, 0 to 1.
    pub artery: Lane,
    /// Absorption by veins, 0 to 1.
    pub vein: Lane,
}

/// Number of neighboring points that are compared with a segment at once.
const GROUP: usize = 8;
type Group = [f32; GROUP];

/// Hasher of a packed cell by one multiplication, whose upper half depends on all its bits.
#[derive(Default)]
pub struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, _: &[u8]) {
        unreachable!("cells are u64")
    }
    fn write_u64(&mut self, key: u64) {
        self.0 = key.wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(32);
    }
}

/// Segment with precomputed values for distances.
struct Piece {
    start: Vec3,
    along: Vec3,
    per_length_squared: f32,
    radii: [f32; 2],
    normal: Vec3,
    visibility: f32,
    is_vein: bool,
}

/// Segments sorted by cell.
pub struct SegmentGrid {
    pieces: Vec<Piece>,
    cells: HashMap<u64, Range<u32>, BuildHasherDefault<CellHasher>>,
    members: Vec<u32>,
    footprint: f32,
}

/// Packs a cell's three indices, each modulo 2²¹.
#[inline(always)]
pub fn pack(cell: [i32; 3]) -> u64 {
    cell.iter().fold(0, |key, &c| (key << 21) | (c as u64 & 0x1f_ffff))
}

#[inline(always)]
fn cell_of(p: Vec3) -> [i32; 3] {
    [floor(p[0] * (1.0 / CELL)), floor(p[1] * (1.0 / CELL)), floor(p[2] * (1.0 / CELL))]
}

/// Half-width over which a vessel of radius `radius` is visible: wider vessels lie deeper in the
/// scattering wall, and none is sharper than a texel.
#[inline(always)]
fn half_width(radius: f32, footprint: f32) -> f32 {
    1.25 * radius + 0.02 + 0.75 * footprint
}

impl SegmentGrid {
    /// Grid of segments, for texels `texel` millimeters wide.
    pub fn new(segments: &[Segment], texel: f32) -> Self {
        let footprint = texel.min(MAX_FOOTPRINT);
        let cells_of = |(number, s): (usize, &Segment)| {
            let margin = half_width(s.radii[0].max(s.radii[1]), footprint);
            let bound = |pick: fn(f32, f32) -> f32, margin: f32| {
                cell_of([0, 1, 2].map(|k| pick(s.ends[0][k], s.ends[1][k]) + margin))
            };
            let (low, high) = (bound(f32::min, -margin), bound(f32::max, margin));
            let mut keys = Vec::new();
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        keys.push((pack([x, y, z]), number as u32));
                    }
                }
            }
            keys
        };
        let mut pairs: Vec<(u64, u32)> =
            segments.par_iter().enumerate().flat_map_iter(cells_of).collect();
        pairs.par_sort_unstable();
        let mut cells: HashMap<u64, Range<u32>, _> = HashMap::default();
        for (at, &(key, _)) in pairs.iter().enumerate() {
            let at = at as u32;
            cells.entry(key).or_insert(at..at).end = at + 1;
        }
        let pieces = segments.iter().map(Piece::new).collect();
        let members = pairs.into_iter().map(|(_, number)| number).collect();
        Self { pieces, cells, members, footprint }
    }

    /// Blood visible at points of the wall; the normals there exclude vessels on the far side of a
    /// fold. Neighbors in the lane mostly share a cell.
    #[inline(always)]
    pub fn blood(&self, points: &Lane3, normals: &Lane3) -> Blood {
        let mut blood = Blood { artery: [0.0; LANES], vein: [0.0; LANES] };
        let mut keys = [0; LANES];
        for (i, key) in keys.iter_mut().enumerate() {
            *key = pack(cell_of(at(points, i)));
        }
        let mut start = 0;
        while start < LANES {
            let same = keys[start..].iter().take_while(|&&key| key == keys[start]).count();
            let end = start + same.min(GROUP);
            if let Some(members) = self.cells.get(&keys[start]) {
                let members = &self.members[members.start as usize..members.end as usize];
                self.blood_of(members, points, normals, start..end, &mut blood);
            }
            start = end;
        }
        blood
    }

    /// Adds blood of some segments visible at the points of some lanes.
    #[inline(always)]
    fn blood_of(
        &self,
        members: &[u32],
        points: &Lane3,
        normals: &Lane3,
        lanes: Range<usize>,
        blood: &mut Blood,
    ) {
        let first = lanes.start.min(LANES - GROUP);
        let (point, normal) = (group(points, first), group(normals, first));
        let mut losses = [[0.0; GROUP]; 2];
        for &number in members {
            let piece = &self.pieces[number as usize];
            piece.add_loss(
                &point,
                &normal,
                self.footprint,
                &mut losses[usize::from(piece.is_vein)],
            );
        }
        for i in lanes {
            (blood.artery[i], blood.vein[i]) = (losses[0][i - first], losses[1][i - first]);
        }
    }
}

#[inline(always)]
fn group(lanes: &Lane3, first: usize) -> [Group; 3] {
    let mut group = [[0.0; GROUP]; 3];
    for k in 0..3 {
        group[k].copy_from_slice(&lanes[k][first..first + GROUP]);
    }
    group
}

impl Piece {
    fn new(segment: &Segment) -> Self {
        let along = sub(segment.ends[1], segment.ends[0]);
        Self {
            start: segment.ends[0],
            along,
            per_length_squared: 1.0 / dot(along, along).max(1e-12),
            radii: segment.radii,
            normal: segment.normal,
            visibility: segment.visibility,
            is_vein: segment.is_vein,
        }
    }

    /// Increases absorption to that of green light by the Beer-Lambert law over the chord of blood
    /// below each point, spread over its visible width; distances are taken along the wall.
    #[inline(always)]
    fn add_loss(
        &self,
        points: &[Group; 3],
        normals: &[Group; 3],
        footprint: f32,
        loss: &mut Group,
    ) {
        let (mut falls, mut chords) = ([0.0; GROUP], [0.0; GROUP]);
        for i in 0..GROUP {
            let normal = at(normals, i);
            let offset = sub(at(points, i), self.start);
            let t = clamp(dot(offset, self.along) * self.per_length_squared, 0.0, 1.0);
            let d = sub(offset, scale(self.along, t));
            let height = dot(d, normal);
            let distance_squared = dot(d, d) - height * height;
            let radius = self.radii[0] + t * (self.radii[1] - self.radii[0]);
            let width = half_width(radius, footprint);
            let fall = 1.0 - distance_squared / (width * width);
            falls[i] = if dot(normal, self.normal) > 0.0 { fall } else { 0.0 };
            chords[i] =
                std::f32::consts::PI * radius * radius / width * (15.0 / 16.0) * fall * fall;
        }
        // Most segments of a cell are visible at few of its points.
        if falls.iter().fold(0.0, |a, &b| max(a, b)) <= 0.0 {
            return;
        }
        for i in 0..GROUP {
            let seen = self.visibility * (1.0 - exp(-BLOOD_ABSORPTION * chords[i]));
            loss[i] = max(loss[i], if falls[i] > 0.0 { seen } else { 0.0 });
        }
    }
}
