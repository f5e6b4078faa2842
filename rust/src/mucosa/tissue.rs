//! Mucosa as a solid texture: color, roughness and relief at a point of the wall.

use super::grid::{Blood, SegmentGrid};
use super::noise::{Cells, Lattice, Vec3, exp, smoothstep, uniform};
use super::strokes::{STROKE_SLOPE, Strokes};
use crate::simd::f32x64::{LANES, Lane, Lane3, add, at, clamp, dot, max, min, scale};
use pyo3::prelude::*;

/// Parameters of a mucosa: `vrcaps.mucosa.mucosa.Mucosa`, whose fields document them.
#[derive(Clone, Copy, FromPyObject)]
pub struct Mucosa {
    pub base_color: [f32; 3],
    pub redness_variation: f32,
    pub patchiness: f32,
    pub bile: f32,
    pub vessel_contrast: f32,
    pub vessel_spacing: f32,
    pub trunk_spacing: f32,
    pub capillary_radius: f32,
    pub relief_slope: f32,
    pub pit_spacing: f32,
    pub pit_slope: f32,
    pub pit_shade: f32,
    pub pit_breaks: f32,
    pub network: f32,
    pub flecks: f32,
    pub mucus: f32,
    pub mucus_tint: [f32; 3],
    pub roughness: f32,
}

/// Points on the wall, one per lane. Lengths in millimeters.
pub struct Places {
    pub point: Lane3,
    pub normal: Lane3,
    /// Mean curvature [1/mm], positive where the wall bulges into the lumen.
    pub curvature: Lane,
    /// Slow variation of the redness.
    pub shade: Lane,
    /// Slow variation of the bile.
    pub region: Lane,
    /// Factors of the segment on the pits, the bile and the vessels.
    pub pits: Lane,
    pub bile: Lane,
    pub vessels: Lane,
}

/// Appearance of the wall at points.
pub struct Samples {
    /// Linear base color.
    pub albedo: Lane3,
    pub roughness: Lane,
    /// Height towards the lumen [mm].
    pub height: Lane,
}

/// Structure of the mucosa at points.
struct Structure {
    patch: Lane,
    mottle: Lane,
    grain: Lane,
    /// Network of the finest vessels, with approximately zero mean.
    mesh: Lane,
    /// Height of the plateaus between pits or strokes: 1 on areae, about 0 in the gaps between them.
    plateau: Lane,
    /// Level of the field that controls the film of mucus.
    level: Lane,
    /// Fraction covered by mucus, 0 to 1.
    cover: Lane,
    /// Height of bumps [mm].
    relief: Lane,
}

/// Absorption of blood in red, green and blue relative to green, arterial and venous: hemoglobin
/// absorbs green and blue alike and little red, more of it without oxygen (S. Prahl's tables,
/// averaged over a camera's bands).
const ARTERIAL: [f32; 3] = [0.16, 1.0, 0.92];
const VENOUS: [f32; 3] = [0.36, 1.0, 0.86];

/// Optical density of bile-stained mucus in red, green and blue: bilirubin absorbs blue, biliverdin
/// red as well. The ratio of red to green does not depend on that of blue to green in capsule images.
const BILE: [f32; 3] = [0.08, 0.13, 1.0];

/// Maximum density of blood, relative to the mean, that a wall lacks.
const PALEST: f32 = 0.25;

/// Spacing of the finest network [mm].
const MESH: f32 = 0.9;

/// Sizes of the bumps of the relief [mm], and the weight of each in its slope.
const BUMPS: [(f32, f32); 3] = [(7.0, 0.7), (2.4, 1.0), (0.9, 1.0)];

/// RMS slope of gradient noise times its spacing.
const UNIT_SLOPE: f32 = 3.3;

/// RMS slope of the plateaus between the pits times their spacing.
const PLATEAU_SLOPE: f32 = 3.5;

/// Mean height of the plateaus, and width of the gaps between them in spacings.
const PLATEAU: f32 = 0.62;
const GAP: f32 = 0.38;

/// Spacing of the possible positions of flecks of mucus [mm], and radii of flecks in spacings.
const FLECK_SPACING: f32 = 3.2;
const FLECK_RADII: [f32; 2] = [0.03, 0.17];

/// Spacing of the strands of mucus [mm], half their width and that of their soft edge in spacings,
/// and the number of deviations below the film's border that they reach.
const STRAND_SPACING: f32 = 7.5;
const STRAND_WIDTHS: [f32; 2] = [0.02, 0.075];
const STRAND_REACH: f32 = 1.1;

/// Standard deviation of the field that controls the film of mucus.
const FILM_DEVIATION: f32 = 0.85;

/// Scattering depth of a full film of mucus, and of a strand.
const FILM_DEPTH: f32 = 1.3;
const STRAND_DEPTH: f32 = 1.3;

/// Variance of patches relative to that of the slow variation along the gut.
const SLOW_SHARE: f32 = 2.6;

/// Mucosa of one patient's wall.
pub struct Tissue {
    mucosa: Mucosa,
    grid: SegmentGrid,
    texel: f32,
    /// Weight of slow variation along the gut, which compensates for missing variance of patches.
    slow: f32,
    contrast: f32,
    /// Reflectance of mucus.
    tint: [f32; 3],
    /// Level of the field at the border of the film of mucus.
    border: f32,
    patch: Lattice,
    mottle: Lattice,
    grain: Lattice,
    film: Lattice,
    strand: Lattice,
    mesh: Lattice,
    warps: [Lattice; 2],
    bumps: [Lattice; 3],
    pits: Cells,
    strokes: Strokes,
    flecks: Cells,
}

impl Tissue {
    /// Tissue of a patient: the seed sets the contrast of its vessels.
    pub fn new(mucosa: Mucosa, seed: u32, grid: SegmentGrid, texel: f32) -> Self {
        let patient = 2.0 * uniform(seed, 0x7061_7469, 0) - 1.0;
        let noise =
            |stream: u32, size: f32| Lattice::new(seed.wrapping_mul(31).wrapping_add(stream), size);
        Self {
            mucosa,
            grid,
            texel,
            slow: (1.0 + SLOW_SHARE * (1.0 - mucosa.patchiness * mucosa.patchiness)).sqrt(),
            contrast: mucosa.vessel_contrast * (1.0 + 0.2 * patient),
            tint: [0, 1, 2].map(|c| (mucosa.base_color[c] * mucosa.mucus_tint[c]).min(0.95)),
            border: FILM_DEVIATION * quantile(mucosa.mucus),
            patch: noise(0, 16.0),
            mottle: noise(1, 4.5),
            grain: noise(2, 1.3),
            film: noise(5, 21.0),
            strand: noise(21, STRAND_SPACING),
            mesh: noise(6, MESH),
            warps: [noise(7, 3.1), noise(8, 1.1)],
            bumps: BUMPS.map(|(size, _)| noise(9 + size as u32, size)),
            pits: Cells::new(seed ^ 0x7069_7473, mucosa.pit_spacing * 1e3),
            strokes: Strokes::new(noise(22, mucosa.pit_spacing * 1e3)),
            flecks: Cells::new(seed ^ 0x6d75_6375, FLECK_SPACING),
        }
    }

    /// Weight of features of a size: 1 if texels resolve them, 0 if they would alias.
    #[inline(always)]
    fn resolved(&self, size: f32) -> f32 {
        smoothstep(2.0, 4.0, size / self.texel)
    }

    /// Depth of the gaps between pits [mm] for their specified slope.
    #[inline(always)]
    fn pit_height(&self) -> f32 {
        let (pits, breaks) = (self.mucosa.pit_spacing * 1e3, self.mucosa.pit_breaks);
        let slope = PLATEAU_SLOPE + breaks * (STROKE_SLOPE - PLATEAU_SLOPE);
        self.mucosa.pit_slope * pits / slope * self.resolved(pits)
    }

    /// Mucosa without any detail.
    pub fn plain(&self) -> Samples {
        let albedo = self.color(0.0, 1.2 * self.mucosa.bile, 0.0, 0.0);
        Samples {
            albedo: albedo.map(|value| [value; LANES]),
            roughness: [self.mucosa.roughness; LANES],
            height: [0.0; LANES],
        }
    }

    /// Evaluates the mucosa at points.
    #[inline(always)]
    pub fn at(&self, places: &Places) -> Samples {
        let warped = self.warped(places);
        let blood = self.grid.blood(&warped, &places.normal);
        let structure = self.structure(&turned_lane(&places.point), &turned_lane(&warped));
        let mut samples = self.plain();
        for i in 0..LANES {
            let (albedo, roughness, height) = self.sample(places, &structure, &blood, i);
            for c in 0..3 {
                samples.albedo[c][i] = albedo[c];
            }
            (samples.roughness[i], samples.height[i]) = (roughness, height);
        }
        samples
    }

    /// Appearance at the point of one lane: color, roughness and height.
    #[inline(always)]
    fn sample(
        &self,
        places: &Places,
        structure: &Structure,
        blood: &Blood,
        i: usize,
    ) -> ([f32; 3], f32, f32) {
        let mucosa = &self.mucosa;
        let (mottle, grain) = (structure.mottle[i], structure.grain[i]);
        let (patch, level, cover) = (structure.patch[i], structure.level[i], structure.cover[i]);
        let crest = smoothstep(0.02, 0.2, places.curvature[i]);
        let valley = smoothstep(0.02, 0.25, -places.curvature[i]);
        let clarity = 0.3 + 0.7 * smoothstep(-1.3, 0.7, patch);
        let seen = self.contrast * (1.0 - 0.85 * crest) * clarity * places.vessels[i];
        let (artery, vein) = (seen * blood.artery[i], seen * blood.vein[i]);
        let gap = (PLATEAU - structure.plateau[i]) * places.pits[i];

        let (patchy, slow) = (mucosa.patchiness, self.slow);
        let shade = slow * places.shade[i]
            + patchy * (0.6 * mottle + 0.3 * grain - patch)
            + mucosa.network * structure.mesh[i];
        let clumped = 0.35 + 0.65 * smoothstep(-1.4, 1.0, mottle + 0.6 * grain);
        let redness = not_paler(mucosa.redness_variation * shade - 0.08 * crest)
            + mucosa.pit_shade * gap * clumped;
        let film = patchy * smoothstep(0.6, 2.2, level);
        let stained = smoothstep(-1.3, 1.7, 0.8 * slow * places.region[i] + 1.3 * patchy * level);
        let pool = 0.15 + 1.8 * stained + 2.5 * film + 1.2 * valley;
        let stain = 1.0 + 4.0 * mucosa.pit_shade * gap * clumped;
        let bile = mucosa.bile * places.bile[i] * pool * (1.0 - 0.4 * crest) * stain;
        let mut albedo = self.color(redness, bile, artery, vein);
        for c in 0..3 {
            albedo[c] += cover * (self.tint[c] - albedo[c]);
        }
        let height =
            structure.relief[i] + self.pit_height() * structure.plateau[i] * places.pits[i];
        let roughness = self.roughness(max(film, cover), mottle, grain);
        (albedo, roughness, height + 0.015 * (artery + vein) + 0.05 * cover)
    }

    /// Noise at points in the lattices' frame, and at warped points, for tortuous vessels.
    #[inline(always)]
    fn structure(&self, p: &Lane3, fine: &Lane3) -> Structure {
        let (mottle, grain) = (self.mottle.gradients(p), self.grain.gradients(p));
        let mut level = self.film.gradients(p);
        for i in 0..LANES {
            level[i] += 0.5 * mottle[i];
        }
        let mut cover = self.mucus(fine, &level, &grain);
        for i in 0..LANES {
            cover[i] = 1.0 - exp(-cover[i]) * (1.0 - self.fleck(at(fine, i), grain[i]));
        }
        Structure {
            patch: self.patch.gradients(p),
            mesh: self.capillary_mesh(fine),
            relief: self.relief(p),
            plateau: self.plateaus(fine),
            cover,
            mottle,
            grain,
            level,
        }
    }

    /// Height of the plateaus: those between a network of gaps, those between strokes, or a blend.
    #[inline(always)]
    fn plateaus(&self, p: &Lane3) -> Lane {
        let breaks = self.mucosa.pit_breaks;
        let mut height = [PLATEAU; LANES];
        if breaks < 1.0 {
            let borders = self.pits.borders(p);
            for i in 0..LANES {
                height[i] += (1.0 - breaks) * (smoothstep(0.0, GAP, borders[i]) - PLATEAU);
            }
        }
        if breaks > 0.0 {
            let depths = self.strokes.depths(p);
            for i in 0..LANES {
                height[i] -= breaks * depths[i];
            }
        }
        height
    }

    #[inline(always)]
    fn color(&self, redness: f32, bile: f32, artery: f32, vein: f32) -> [f32; 3] {
        let mut color = self.mucosa.base_color;
        for (c, value) in color.iter_mut().enumerate() {
            let density = redness * ARTERIAL[c] + bile * BILE[c];
            let vessels = (1.0 - artery * ARTERIAL[c]) * (1.0 - vein * VENOUS[c]);
            *value = clamp(*value * exp(-density) * vessels, 0.01, 0.95);
        }
        color
    }

    #[inline(always)]
    fn roughness(&self, film: f32, mottle: f32, grain: f32) -> f32 {
        let dry = self.mucosa.roughness + 0.05 * mottle + 0.03 * grain;
        clamp(dry * (1.0 - 0.35 * film), 0.1, 1.0)
    }

    /// Fraction covered by a fleck of mucus, 0 to 1.
    #[inline(always)]
    fn fleck(&self, p: Vec3, grain: f32) -> f32 {
        let (offset, number) = self.flecks.own(p);
        let fraction = self.mucosa.flecks;
        // Few of the existing flecks are large.
        let size = number / fraction;
        let radius = FLECK_RADII[0] + (FLECK_RADII[1] - FLECK_RADII[0]) * size * size * size;
        let distance = dot(offset, offset).sqrt() * (1.0 + 0.25 * grain);
        let cover = 0.8 * (1.0 - smoothstep(0.7 * radius, radius, distance));
        if number < fraction { cover } else { 0.0 }
    }

    /// Scattering depth of mucus: a film where `level` is high, and strands that extend beyond it.
    #[inline(always)]
    fn mucus(&self, p: &Lane3, level: &Lane, grain: &Lane) -> Lane {
        let highest = level.iter().fold(f32::NEG_INFINITY, |a, &b| max(a, b));
        if highest - self.border <= -STRAND_REACH {
            return [0.0; LANES];
        }
        let mut depth = self.strand.gradients(p);
        for i in 0..LANES {
            let above = level[i] - self.border;
            let distance = depth[i].abs() / UNIT_SLOPE;
            let width = smoothstep(-STRAND_REACH, 0.5, above + 0.3 * grain[i]);
            let [half, edge] = [STRAND_WIDTHS[0] * width, STRAND_WIDTHS[1] * width];
            let strand = width * (1.0 - smoothstep(half, max(edge, 1e-4), distance));
            let film = smoothstep(0.0, 1.1, above);
            let clotted = max(1.0 + 0.5 * grain[i], 0.1);
            let mucus = clotted * (FILM_DEPTH * film + STRAND_DEPTH * strand);
            depth[i] = if above > -STRAND_REACH { mucus } else { 0.0 };
        }
        depth
    }

    /// Points displaced along the wall, for tortuous vessels.
    #[inline(always)]
    fn warped(&self, places: &Places) -> Lane3 {
        let mut warped = [[0.0; LANES]; 3];
        for i in 0..LANES {
            let (point, normal) = (at(&places.point, i), at(&places.normal, i));
            let (slow, quick) =
                (self.warps[0].displacement(point), self.warps[1].displacement(point));
            let shift = add(scale(slow, 0.75), scale(quick, 0.2));
            let lift = dot(shift, normal);
            for k in 0..3 {
                warped[k][i] = point[k] + shift[k] - lift * normal[k];
            }
        }
        warped
    }

    /// Network of the finest vessels: ridges of noise, if texels resolve them.
    #[inline(always)]
    fn capillary_mesh(&self, p: &Lane3) -> Lane {
        let (mut mesh, resolved) = (self.mesh.gradients(p), self.resolved(0.6 * MESH));
        for value in &mut mesh {
            let ridge = 1.0 - min((0.9 * *value).abs(), 1.0);
            *value = ridge * ridge * resolved - 0.3;
        }
        mesh
    }

    /// Relief [mm] from bumps of three sizes, each weighted by slope.
    #[inline(always)]
    fn relief(&self, p: &Lane3) -> Lane {
        let mut height = [0.0; LANES];
        for (bump, (size, fraction)) in self.bumps.iter().zip(BUMPS) {
            let (noise, resolved) = (bump.gradients(p), self.resolved(size));
            for i in 0..LANES {
                height[i] += noise[i] * fraction * size * resolved;
            }
        }
        for value in &mut height {
            *value = *value * self.mucosa.relief_slope / UNIT_SLOPE;
        }
        height
    }
}

/// Optical density of blood relative to the mean, not below `-PALEST`: a wall is never without blood.
#[inline(always)]
fn not_paler(redness: f32) -> f32 {
    let missing = max(-redness, 0.0);
    max(redness, 0.0) - missing * PALEST / (PALEST + missing)
}

/// Quantile of the standard normal distribution for a probability to exceed it, to 0.01 from 0.02
/// to 0.98 (by the logistic distribution); above all levels for a probability of 0.
fn quantile(chance: f32) -> f32 {
    if chance <= 0.0 { 99.0 } else { ((1.0 - chance) / chance).ln() / 1.702 }
}

/// Rotation with Pythagorean numbers, so that walls are not aligned with the noise's lattice.
#[inline(always)]
pub fn turned(p: Vec3) -> Vec3 {
    [
        0.36 * p[0] + 0.48 * p[1] - 0.8 * p[2],
        -0.8 * p[0] + 0.6 * p[1],
        0.48 * p[0] + 0.64 * p[1] + 0.6 * p[2],
    ]
}

#[inline(always)]
fn turned_lane(p: &Lane3) -> Lane3 {
    let mut result = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let vector = turned(at(p, i));
        for k in 0..3 {
            result[k][i] = vector[k];
        }
    }
    result
}
