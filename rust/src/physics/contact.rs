//! Contact with a soft wall: an elastic foundation, integrated over the touched patch.
//!
//! The wall is a layer on a rigid ground, a bed of independent springs (Johnson, Contact Mechanics,
//! 1985, 4.3). A point of the wall at distance s from the capsule's axis is pressed in by
//! `u = R − s`; its pressure acts along the capsule's normal there. The force is so the gradient
//! of an energy `∫ψ(u) dA`, and a capsule that comes and goes slowly gets all of it back.

use super::body::{Axis, Body, Motion};
use glam::DVec3;

/// Sub-triangles at the edge of the patch are at most this share of its radius.
const FINENESS: f64 = 0.5;
/// Half the width of a uniform spread of the same variance as an equilateral triangle's, along any
/// line, by its circumradius: √(3/8).
const HALF_WIDTH: f64 = 0.612;
/// No sub-triangle becomes smaller than this share of the capsule's radius.
const FINEST: f64 = 1.0 / 40.0;
/// Whole inside the patch, ρ² up to this times R·u is fine enough.
const FLATNESS: f64 = 0.6;
/// Share of the depth of an e-fold of stiffness that the depth may change within a sub-triangle.
const STEEPNESS: f64 = 0.5;
/// Cosine between the wall's normal and the capsule's below which a wall begins to face away.
const GRAZING: f64 = 0.2;

/// Pressure of the wall's thickness against indentation.
#[derive(Clone, Copy)]
pub struct Foundation {
    /// Pressure by depth of a slight indentation [Pa/m].
    pub stiffness: f64,
    /// Growth of stiffness: e-fold for each such depth [m]; infinite for a linear wall.
    pub stiffening_depth: f64,
    /// Growth of pressure with the logarithm of the speed of indentation.
    pub rate_gain: f64,
    /// Speed of indentation at which that growth begins [m/s].
    pub rate: f64,
}

/// Pressure [Pa] and its slopes.
struct Pressure {
    value: f64,
    by_depth: f64,
    by_speed: f64,
}

/// Beyond this many e-folds the wall stiffens no more, so that numbers stay finite.
const MOST_FOLDS: f64 = 25.0;

impl Foundation {
    /// Elastic pressure φ [Pa], its slope [Pa/m] and its integral [J/m²], with l the depth of an
    /// e-fold: `φ = K l (exp(u/l) − 1)`, exponential as soft tissue is (Fung, Biomechanics, 1993).
    #[inline(always)]
    fn elastic(&self, depth: f64) -> (f64, f64, f64) {
        let (k, l) = (self.stiffness, self.stiffening_depth);
        if !l.is_finite() {
            return (k * depth, k, 0.5 * k * depth * depth);
        }
        let folds = (depth / l).min(MOST_FOLDS);
        let (over, growth) = (depth - folds * l, folds.exp_m1());
        let (pressure, slope) = (k * l * growth, k * (1.0 + growth));
        let energy = k * l * l * (growth - folds);
        (pressure + slope * over, slope, energy + (pressure + 0.5 * slope * over) * over)
    }

    /// `p = φ(u) (1 + g asinh(u̇/u̇₀))`, never below 0.
    #[inline(always)]
    fn pressure(&self, depth: f64, speed: f64) -> Pressure {
        let (elastic, slope, _) = self.elastic(depth);
        if self.rate_gain == 0.0 {
            return Pressure { value: elastic, by_depth: slope, by_speed: 0.0 };
        }
        let x = speed / self.rate;
        let root = (1.0 + x * x).sqrt();
        // asinh without care for tiny x, whose error only matters beside 1.
        let factor = 1.0 + self.rate_gain * (x.abs() + root).ln().copysign(x);
        if factor <= 0.0 {
            return Pressure { value: 0.0, by_depth: 0.0, by_speed: 0.0 };
        }
        Pressure {
            value: elastic * factor,
            by_depth: slope * factor,
            by_speed: elastic * self.rate_gain / (self.rate * root),
        }
    }
}

/// A triangle of the wall as the capsule meets it.
#[derive(Clone, Copy)]
pub struct Facet {
    /// Corners [m].
    pub corners: [DVec3; 3],
    /// Mean velocity of the corners [m/s].
    pub velocity: DVec3,
    /// Its place among what is near.
    pub place: u32,
}

/// A small piece of the patch.
pub struct Sample {
    /// The capsule's normal, and its moment about the centre of mass: turns twists into speeds.
    pub lever: [f64; 6],
    /// Speed of indentation [m/s].
    pub speed: f64,
    /// Force along the normal [N].
    pub load: f64,
    /// Its slope by depth [N/m].
    pub stiffness: f64,
    /// Its slope by speed [N·s/m].
    pub damping: f64,
    /// Place of its triangle among what is near.
    pub place: u32,
}

/// What one triangle of the wall carries.
pub struct Grip {
    /// Middle of its pressure [m].
    pub center: DVec3,
    /// Unit normal of the capsule there.
    pub normal: DVec3,
    /// Normal force [N].
    pub load: f64,
    /// Velocity of the wall there [m/s].
    pub velocity: DVec3,
    /// How much faster the wall there moves for each newton within a substep [m/s per N]; 0 where
    /// it does not.
    pub mobility: f64,
    /// Its place among what is near.
    pub place: u32,
}

/// The patch of one instant.
#[derive(Default)]
pub struct Patch {
    /// Pieces, in order of triangles.
    pub samples: Vec<Sample>,
    /// Triangles that touch.
    pub grips: Vec<Grip>,
    /// Stored energy [J].
    pub energy: f64,
    /// Touched area [m²].
    pub area: f64,
    /// Largest depth [m].
    pub depth: f64,
}

impl Patch {
    /// Empties the patch; its memory stays.
    pub fn clear(&mut self) {
        self.samples.clear();
        self.grips.clear();
        (self.energy, self.area, self.depth) = (0.0, 0.0, 0.0);
    }
}

/// Sums over the pieces of one triangle.
#[derive(Default)]
struct Sum {
    load: f64,
    moment: DVec3,
    normal: DVec3,
}

/// One capsule at one instant, pressing into triangles.
pub struct Indenter<'a> {
    /// The wall's stiffness.
    pub foundation: &'a Foundation,
    /// The capsule's radius [m].
    pub radius: f64,
    /// Its axis.
    pub axis: Axis,
    /// Its motion.
    pub motion: &'a Motion,
    /// Most that the depth may change within a sub-triangle [m].
    steep: f64,
}

impl<'a> Indenter<'a> {
    /// The capsule `body` in motion `m`.
    pub fn new(foundation: &'a Foundation, body: &Body, motion: &'a Motion) -> Self {
        Indenter {
            foundation,
            radius: body.radius,
            axis: body.axis(motion),
            motion,
            steep: STEEPNESS * foundation.stiffening_depth,
        }
    }

    /// Adds what one triangle carries to the patch.
    pub fn press(&self, facet: &Facet, patch: &mut Patch) {
        let [a, b, c] = facet.corners;
        let center = (a + b + c) / 3.0;
        let reach = facet.corners.map(|p| (p - center).length_squared());
        let reach = reach[0].max(reach[1]).max(reach[2]).sqrt();
        let offset = center - self.axis.nearest(center);
        if offset.length_squared() >= (self.radius + reach) * (self.radius + reach) {
            return;
        }
        let cross = (b - a).cross(c - a);
        let twice_area = cross.length();
        if twice_area == 0.0 {
            return;
        }
        let triangle = Triangle { facet, normal: cross / twice_area };
        let mut sum = Sum::default();
        self.visit(&triangle, facet.corners, reach, 0.5 * twice_area, patch, &mut sum);
        if sum.load > 0.0 {
            patch.grips.push(Grip {
                center: sum.moment / sum.load,
                normal: sum.normal.normalize_or_zero(),
                load: sum.load,
                velocity: facet.velocity,
                mobility: 0.0,
                place: facet.place,
            });
        }
    }

    /// Integrates over a sub-triangle, in four where it is too coarse.
    fn visit(
        &self,
        triangle: &Triangle,
        corners: [DVec3; 3],
        reach: f64,
        area: f64,
        patch: &mut Patch,
        sum: &mut Sum,
    ) {
        let [a, b, c] = corners;
        let center = (a + b + c) / 3.0;
        let offset = center - self.axis.nearest(center);
        let distance = offset.length();
        if distance - reach >= self.radius || distance == 0.0 {
            return;
        }
        let normal = offset / distance;
        let facing = -normal.dot(triangle.normal);
        if self.is_coarse(reach, distance, facing) {
            let [ab, bc, ca] = [0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)];
            for quarter in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]] {
                self.visit(triangle, quarter, 0.5 * reach, 0.25 * area, patch, sum);
            }
            return;
        }
        // The mean depth is less than the middle's, as the capsule is round: by half the variance
        // ρ²/8 of an equilateral triangle's points along a line times the curvature, in one
        // direction at the cylinder and in two at the ends. At the edge of the patch depth falls
        // evenly through the sub-triangle: only the pressed share counts, at its own mean depth.
        let bend = if self.axis.is_beyond(center) { 2.0 } else { 1.0 };
        let depth = self.radius - distance - bend * reach * reach / (16.0 * distance);
        let spread = HALF_WIDTH * reach * (1.0 - facing * facing).max(0.0).sqrt();
        let pressed = (0.5 * (depth + spread) / spread).min(1.0);
        if depth + spread > 0.0 && facing > 0.0 {
            let depth = if pressed < 1.0 { 0.5 * (depth + spread) } else { depth };
            let area = area * pressed * (facing / GRAZING).min(1.0);
            patch.depth = patch.depth.max(self.radius - distance);
            self.sample(triangle, center, normal, depth, area, patch, sum);
        }
    }

    /// Whether a sub-triangle must be divided: against the radius of the patch, which for a flat
    /// wall is R sin θ at its edge, and against how fast the depth changes inside.
    fn is_coarse(&self, reach: f64, distance: f64, facing: f64) -> bool {
        if reach <= FINEST * self.radius {
            return false;
        }
        let sine_square = 1.0 - facing * facing;
        let edge = FINENESS * self.radius;
        if reach * reach * sine_square > self.steep * self.steep {
            return true;
        }
        if reach * reach <= edge * edge * sine_square {
            return false;
        }
        let whole = distance + reach < self.radius;
        !whole || reach * reach > FLATNESS * self.radius * (self.radius - distance)
    }

    #[allow(clippy::too_many_arguments)]
    fn sample(
        &self,
        triangle: &Triangle,
        center: DVec3,
        normal: DVec3,
        depth: f64,
        area: f64,
        patch: &mut Patch,
        sum: &mut Sum,
    ) {
        let arm = center - self.motion.position;
        let moment = arm.cross(normal);
        let speed = normal.dot(self.motion.velocity - triangle.facet.velocity)
            + moment.dot(self.motion.angular_velocity);
        let pressure = self.foundation.pressure(depth, speed);
        let load = pressure.value * area;
        patch.samples.push(Sample {
            lever: [normal.x, normal.y, normal.z, moment.x, moment.y, moment.z],
            speed,
            load,
            stiffness: pressure.by_depth * area,
            damping: pressure.by_speed * area,
            place: triangle.facet.place,
        });
        patch.energy += self.foundation.elastic(depth).2 * area;
        patch.area += area;
        sum.load += load;
        sum.moment += load * center;
        sum.normal += load * normal;
    }
}

/// A triangle with its normal into the lumen.
struct Triangle<'a> {
    facet: &'a Facet,
    normal: DVec3,
}
