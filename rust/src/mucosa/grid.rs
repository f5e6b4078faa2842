//! Vessel segments by the cells of space they touch, and the blood seen at a point.

use super::noise::{Vec3, exp, floor};
use super::vessels::{Segment, dot, sub};
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::Range;

/// Edge of a cell [mm].
const CELL: f32 = 1.0;

/// Width over which coarse texels still blur vessels [mm].
const MAX_FOOTPRINT: f32 = 0.3;

/// Absorption of whole blood in green light [1/mm], about 25 at 550 nm and less over a camera's
/// broad band (Bosschaart et al., Lasers Med Sci 29:453, 2014).
const BLOOD_ABSORPTION: f32 = 25.0;

/// Share of green light that blood takes away, from arteries and from veins.
#[derive(Clone, Copy, Default)]
pub struct Blood {
    /// Loss to arteries, 0 to 1.
    pub artery: f32,
    /// Loss to veins, 0 to 1.
    pub vein: f32,
}

/// Hashes a packed cell by one multiplication.
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
        self.0 = key.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}

/// A segment ready to be measured against.
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

/// The cell looked up last: neighboring texels mostly share it.
pub struct Cursor {
    key: u64,
    members: Range<u32>,
}

impl Cursor {
    /// A cursor that has looked up nothing.
    pub fn new() -> Self {
        Self { key: u64::MAX, members: 0..0 }
    }
}

/// A cell's three numbers, each modulo 2²¹, as one.
#[inline(always)]
pub fn pack(cell: [i32; 3]) -> u64 {
    cell.iter().fold(0, |key, &c| (key << 21) | (c as u64 & 0x1f_ffff))
}

#[inline(always)]
fn cell_of(p: Vec3) -> [i32; 3] {
    p.map(|x| floor(x * (1.0 / CELL)))
}

/// Half-width over which a vessel of radius `radius` is seen: wider vessels lie deeper in the
/// scattering wall, and none is sharper than a texel.
#[inline(always)]
fn half_width(radius: f32, footprint: f32) -> f32 {
    1.25 * radius + 0.02 + 0.75 * footprint
}

impl SegmentGrid {
    /// Sorts segments into cells, for texels `texel` millimeters wide.
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

    /// Blood seen at a point of the wall; the normal there keeps out vessels of the far side of
    /// a fold.
    #[inline(always)]
    pub fn blood(&self, cursor: &mut Cursor, point: Vec3, normal: Vec3) -> Blood {
        let key = pack(cell_of(point));
        if key != cursor.key {
            cursor.key = key;
            cursor.members = self.cells.get(&key).cloned().unwrap_or(0..0);
        }
        let mut blood = Blood::default();
        let range = cursor.members.start as usize..cursor.members.end as usize;
        for &number in &self.members[range] {
            let piece = &self.pieces[number as usize];
            let loss = piece.loss(point, normal, self.footprint);
            let slot = if piece.is_vein { &mut blood.vein } else { &mut blood.artery };
            *slot = slot.max(loss);
        }
        blood
    }
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

    /// Loss of green light by Beer and Lambert over the chord of blood below the point, spread
    /// over the width in which it is seen; distances are taken along the wall.
    #[inline(always)]
    fn loss(&self, point: Vec3, normal: Vec3, footprint: f32) -> f32 {
        let offset = sub(point, self.start);
        let t = (dot(offset, self.along) * self.per_length_squared).clamp(0.0, 1.0);
        let d = [0, 1, 2].map(|k| offset[k] - t * self.along[k]);
        let height = dot(d, normal);
        let distance_squared = dot(d, d) - height * height;
        let radius = self.radii[0] + t * (self.radii[1] - self.radii[0]);
        let width = half_width(radius, footprint);
        let fall = 1.0 - distance_squared / (width * width);
        if fall <= 0.0 || dot(normal, self.normal) <= 0.0 {
            return 0.0;
        }
        let chord = std::f32::consts::PI * radius * radius / width * (15.0 / 16.0) * fall * fall;
        self.visibility * (1.0 - exp(-BLOOD_ABSORPTION * chord))
    }
}
