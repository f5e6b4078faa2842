//! The mucosa as a solid function: color, roughness and relief at a point of the wall.

use super::grid::{Blood, Cursor, SegmentGrid};
use super::noise::{Cells, Lattice, Vec3, exp, smoothstep, uniform};
use super::vessels::dot;
use pyo3::prelude::*;

/// Character of a mucosa: `vrcaps.mucosa.mucosa.Mucosa`, whose fields say what they mean.
#[derive(Clone, Copy, FromPyObject)]
pub struct Mucosa {
    pub base_color: [f32; 3],
    pub redness_variation: f32,
    pub bile: f32,
    pub vessel_contrast: f32,
    pub vessel_spacing: f32,
    pub trunk_spacing: f32,
    pub capillary_radius: f32,
    pub relief_slope: f32,
    pub pit_spacing: f32,
    pub pit_slope: f32,
    pub pit_shade: f32,
    pub network: f32,
    pub flecks: f32,
    pub mucus: f32,
    pub mucus_tint: [f32; 3],
    pub roughness: f32,
}

/// A place on the wall. Lengths in millimeters.
#[derive(Clone, Copy)]
pub struct Place {
    pub point: Vec3,
    pub normal: Vec3,
    /// Mean curvature [1/mm], positive where the wall bulges into the lumen.
    pub curvature: f32,
    /// Slow variation of the redness.
    pub shade: f32,
    /// Slow variation of the bile.
    pub region: f32,
    /// Factors of the segment on the pits, the bile and the vessels.
    pub pits: f32,
    pub bile: f32,
    pub vessels: f32,
}

/// What the wall is like at a place.
#[derive(Clone, Copy)]
pub struct Sample {
    /// Linear base color.
    pub albedo: [f32; 3],
    pub roughness: f32,
    /// Towards the lumen [mm].
    pub height: f32,
}

/// Absorption of blood in red, green and blue relative to green, arterial and venous: hemoglobin
/// takes green and blue alike and little red, less so without oxygen (S. Prahl's tables, averaged
/// over a camera's bands).
const ARTERIAL: [f32; 3] = [0.16, 1.0, 0.92];
const VENOUS: [f32; 3] = [0.36, 1.0, 0.86];

/// Optical density of bile-stained mucus in red, green and blue.
const BILE: [f32; 3] = [0.04, 0.16, 1.0];

/// Spacing of the finest network [mm].
const MESH: f32 = 0.9;

/// Sizes of the bumps of the relief [mm], and the share of its slope that each takes.
const BUMPS: [(f32, f32); 3] = [(7.0, 0.7), (2.4, 1.0), (0.9, 1.0)];

/// RMS slope of gradient noise times its spacing.
const UNIT_SLOPE: f32 = 3.3;

/// RMS slope of the plateaus between the pits times their spacing.
const PLATEAU_SLOPE: f32 = 3.5;

/// Mean height of the plateaus, and width of the gaps between them in spacings.
const PLATEAU: f32 = 0.62;
const GAP: f32 = 0.38;

/// Spacing of the places where a fleck of mucus may lie [mm], and the radii of flecks in spacings.
const FLECK_SPACING: f32 = 3.2;
const FLECK_RADII: [f32; 2] = [0.03, 0.17];

/// Spacing of the strands of mucus [mm], half their width and that of their soft edge as shares of
/// it, and how many deviations short of the film's border they reach.
const STRAND_SPACING: f32 = 7.5;
const STRAND_WIDTHS: [f32; 2] = [0.02, 0.075];
const STRAND_REACH: f32 = 1.1;

/// Deviation of the field that lays the film of mucus.
const FILM_DEVIATION: f32 = 0.85;

/// Scattering depth of the film of mucus where it is whole, and of a strand.
const FILM_DEPTH: f32 = 1.3;
const STRAND_DEPTH: f32 = 1.3;

/// A mucosa grown over one patient's wall.
pub struct Tissue {
    mucosa: Mucosa,
    seed: u32,
    vessels: SegmentGrid,
    texel: f32,
    redness: f32,
    contrast: f32,
    /// Reflectance of mucus.
    mucus: [f32; 3],
    /// Level of its field from which the film of mucus begins.
    border: f32,
}

impl Tissue {
    /// A patient: the seed sets how red the wall is and how clearly its vessels show.
    pub fn new(mucosa: Mucosa, seed: u32, vessels: SegmentGrid, texel: f32) -> Self {
        let patient = |number: u32| 2.0 * uniform(seed, 0x7061_7469, number) - 1.0;
        Self {
            mucosa,
            seed,
            vessels,
            texel,
            redness: mucosa.redness_variation * patient(0),
            contrast: mucosa.vessel_contrast * (1.0 + 0.2 * patient(1)),
            mucus: [0, 1, 2].map(|c| (mucosa.base_color[c] * mucosa.mucus_tint[c]).min(0.95)),
            border: FILM_DEVIATION * quantile(mucosa.mucus),
        }
    }

    /// A brush for one run of neighboring texels.
    pub fn brush(&self) -> Brush<'_> {
        let noise = |stream: u32, size: f32| {
            Lattice::new(self.seed.wrapping_mul(31).wrapping_add(stream), size)
        };
        Brush {
            tissue: self,
            cursor: Cursor::new(),
            patch: noise(0, 16.0),
            mottle: noise(1, 4.5),
            grain: noise(2, 1.3),
            film: noise(5, 21.0),
            strand: noise(21, STRAND_SPACING),
            mesh: noise(6, MESH),
            flecks: Cells::new(self.seed ^ 0x6d75_6375, FLECK_SPACING),
            warps: [noise(7, 3.1), noise(8, 1.1)],
            bumps: BUMPS.map(|(size, _)| noise(9 + size as u32, size)),
            pits: Cells::new(self.seed ^ 0x7069_7473, self.mucosa.pit_spacing * 1e3),
        }
    }

    /// 1 for features wide enough for the texels to hold, 0 for those that would alias.
    #[inline(always)]
    fn resolved(&self, size: f32) -> f32 {
        smoothstep(2.0, 4.0, size / self.texel)
    }

    /// Depth of the gaps between pits [mm] for the slope they shall have.
    fn pit_height(&self) -> f32 {
        let pits = self.mucosa.pit_spacing * 1e3;
        self.mucosa.pit_slope * pits / PLATEAU_SLOPE * self.resolved(pits)
    }

    /// The mucosa without any detail.
    pub fn plain(&self) -> Sample {
        let albedo = self.color(self.redness, 1.2 * self.mucosa.bile, Blood::default());
        Sample { albedo, roughness: self.mucosa.roughness, height: 0.0 }
    }

    #[inline(always)]
    fn color(&self, redness: f32, bile: f32, blood: Blood) -> [f32; 3] {
        [0, 1, 2].map(|c| {
            let density = redness * ARTERIAL[c] + bile * BILE[c];
            let vessels = (1.0 - blood.artery * ARTERIAL[c]) * (1.0 - blood.vein * VENOUS[c]);
            (self.mucosa.base_color[c] * exp(-density) * vessels).clamp(0.01, 0.95)
        })
    }

    #[inline(always)]
    fn roughness(&self, film: f32, mottle: f32, grain: f32) -> f32 {
        let dry = self.mucosa.roughness + 0.05 * mottle + 0.03 * grain;
        (dry * (1.0 - 0.35 * film)).clamp(0.1, 1.0)
    }
}

/// Evaluates a tissue along neighboring texels: it keeps what they share.
pub struct Brush<'a> {
    tissue: &'a Tissue,
    cursor: Cursor,
    patch: Lattice,
    mottle: Lattice,
    grain: Lattice,
    film: Lattice,
    strand: Lattice,
    mesh: Lattice,
    warps: [Lattice; 2],
    bumps: [Lattice; 3],
    pits: Cells,
    flecks: Cells,
}

impl Brush<'_> {
    /// Evaluates the mucosa at a place.
    #[inline(always)]
    pub fn at(&mut self, place: &Place) -> Sample {
        let tissue = self.tissue;
        let p = turned(place.point);
        let crest = smoothstep(0.02, 0.2, place.curvature);
        let valley = smoothstep(0.02, 0.25, -place.curvature);
        let patch = self.patch.gradient(p);
        let mottle = self.mottle.gradient(p);
        let grain = self.grain.gradient(p);
        let warp = self.warp(place);
        let fine = turned(warp);
        let clarity = 0.3 + 0.7 * smoothstep(-1.3, 0.7, patch);
        let seen = tissue.contrast * (1.0 - 0.85 * crest) * clarity * place.vessels;
        let blood = tissue.vessels.blood(&mut self.cursor, warp, place.normal);
        let blood = Blood { artery: seen * blood.artery, vein: seen * blood.vein };
        let plateau = self.plateau(fine);
        let gap = (PLATEAU - plateau) * place.pits;

        let shade = place.shade - patch
            + 0.6 * mottle
            + 0.3 * grain
            + tissue.mucosa.network * self.capillary_mesh(fine);
        let clumped = 0.35 + 0.65 * smoothstep(-1.4, 1.0, mottle + 0.6 * grain);
        let redness = tissue.redness + tissue.mucosa.redness_variation * shade - 0.18 * crest
            + tissue.mucosa.pit_shade * gap * clumped;
        let level = self.film.gradient(p) + 0.5 * mottle;
        let film = smoothstep(0.6, 2.2, level);
        let stained = smoothstep(-1.3, 1.7, 0.8 * place.region + 1.3 * level);
        let pool = 0.15 + 1.8 * stained + 2.5 * film + 1.2 * valley;
        let stain = 1.0 + 4.0 * tissue.mucosa.pit_shade * gap * clumped;
        let bile = tissue.mucosa.bile * place.bile * pool * (1.0 - 0.6 * crest) * stain;
        let mucus = self.mucus(fine, level, grain);
        let cover = 1.0 - exp(-mucus) * (1.0 - self.fleck(fine, grain));
        let mut albedo = tissue.color(redness, bile, blood);
        for c in 0..3 {
            albedo[c] += cover * (tissue.mucus[c] - albedo[c]);
        }
        let height = self.relief(p) + tissue.pit_height() * plateau * place.pits;
        Sample {
            albedo,
            roughness: tissue.roughness(film.max(cover), mottle, grain),
            height: height + 0.015 * (blood.artery + blood.vein) + 0.05 * cover,
        }
    }

    /// Height of the plateaus between pits: 1 on villi or areae, 0 in the gaps between them.
    #[inline(always)]
    fn plateau(&mut self, p: Vec3) -> f32 {
        smoothstep(0.0, GAP, self.pits.border(p))
    }

    /// Cover by a fleck of mucus, 0 to 1.
    #[inline(always)]
    fn fleck(&mut self, p: Vec3, grain: f32) -> f32 {
        let (offset, number) = self.flecks.own(p);
        let fraction = self.tissue.mucosa.flecks;
        if number >= fraction {
            return 0.0;
        }
        // Among the flecks that are there, few are large.
        let size = number / fraction;
        let radius = FLECK_RADII[0] + (FLECK_RADII[1] - FLECK_RADII[0]) * size * size * size;
        let distance = dot(offset, offset).sqrt() * (1.0 + 0.25 * grain);
        0.8 * (1.0 - smoothstep(0.7 * radius, radius, distance))
    }

    /// Scattering depth of mucus: a film where `level` is high, and strands that run on beyond it.
    #[inline(always)]
    fn mucus(&mut self, p: Vec3, level: f32, grain: f32) -> f32 {
        let above = level - self.tissue.border;
        if above <= -STRAND_REACH {
            return 0.0;
        }
        let distance = self.strand.gradient(p).abs() / UNIT_SLOPE;
        let width = smoothstep(-STRAND_REACH, 0.5, above + 0.3 * grain);
        let [half, edge] = STRAND_WIDTHS.map(|fraction| fraction * width);
        let strand = width * (1.0 - smoothstep(half, edge.max(1e-4), distance));
        let film = smoothstep(0.0, 1.1, above);
        let clotted = (1.0 + 0.5 * grain).max(0.1);
        clotted * (FILM_DEPTH * film + STRAND_DEPTH * strand)
    }

    /// The place moved along the wall, so that vessels wind.
    #[inline(always)]
    fn warp(&mut self, place: &Place) -> Vec3 {
        let slow = self.warps[0].displacement(place.point);
        let quick = self.warps[1].displacement(place.point);
        let shift = [0, 1, 2].map(|k| 0.75 * slow[k] + 0.2 * quick[k]);
        let lift = dot(shift, place.normal);
        [0, 1, 2].map(|k| place.point[k] + shift[k] - lift * place.normal[k])
    }

    /// Network of the finest vessels, about zero mean: ridges of noise, where texels hold them.
    #[inline(always)]
    fn capillary_mesh(&mut self, p: Vec3) -> f32 {
        let ridge = 1.0 - (0.9 * self.mesh.gradient(p)).abs().min(1.0);
        ridge * ridge * self.tissue.resolved(0.6 * MESH) - 0.3
    }

    /// Relief [mm] from bumps of three sizes, each by its slope.
    #[inline(always)]
    fn relief(&mut self, p: Vec3) -> f32 {
        let tissue = self.tissue;
        let mut height = 0.0;
        for (bump, (size, fraction)) in self.bumps.iter_mut().zip(BUMPS) {
            height += bump.gradient(p) * fraction * size * tissue.resolved(size);
        }
        height * tissue.mucosa.relief_slope / UNIT_SLOPE
    }
}

/// The level that a standard normal variable exceeds with a chance, to 0.01 from 0.02 to 0.98
/// (through the logistic distribution); above all levels for a chance of 0.
fn quantile(chance: f32) -> f32 {
    if chance <= 0.0 { 99.0 } else { ((1.0 - chance) / chance).ln() / 1.702 }
}

/// A rotation by Pythagorean numbers, so that no wall lies along the noise's lattice by habit.
#[inline(always)]
pub fn turned(p: Vec3) -> Vec3 {
    [
        0.36 * p[0] + 0.48 * p[1] - 0.8 * p[2],
        -0.8 * p[0] + 0.6 * p[1],
        0.48 * p[0] + 0.64 * p[1] + 0.6 * p[2],
    ]
}
