//! Contact with a soft wall: subdivision of its triangles into pieces under the capsule.
//!
//! The wall is a layer on a rigid ground, a bed of independent springs (Johnson, Contact Mechanics,
//! 1985, 4.3). A point of the wall at distance s from the capsule's axis is indented by
//! `u = R − s`; its pressure acts along the capsule's normal there. The force is thus the gradient
//! of an energy `∫ψ(u) dA`, and a slow approach and retreat of the capsule dissipates nothing.
//! Triangles are divided until the depth is nearly linear within a piece; `patch` sums the pieces.

use super::body::{Axis, Body, Motion};
use super::contact_patch::{Patch, Pressing};
use crate::simd::f64x8::{max, put};
use crate::tissue::winkler_foundation::WinklerFoundation;
use glam::DVec3;

/// Maximum size of a piece on the edge of the patch, as a fraction of the patch's radius.
const FINENESS: f64 = 0.6;
/// Limit of ρ² near the patch's middle, as a factor of R·u.
const FLATNESS: f64 = 0.6;
/// Minimum size of any piece, as a fraction of the radius of the whole patch.
const FINER: f64 = 0.4;
/// Minimum size of a piece, as a fraction of the capsule's radius.
const FINEST: f64 = 1.0 / 40.0;
/// Maximum size of a piece, as a fraction of the capsule's radius: its normal turns in a piece.
const COARSEST: f64 = 0.3;
/// Maximum change of depth within a piece, as a fraction of the depth of an e-fold of stiffness.
const STEEPNESS: f64 = 1.0;

/// Triangle of the wall relative to the capsule.
#[derive(Clone, Copy)]
pub struct Facet {
    /// Corners [m].
    pub corners: [DVec3; 3],
    /// Mean velocity of the corners [m/s].
    pub velocity: DVec3,
    /// Distance of the farthest corner from the centroid [m].
    pub reach: f64,
    /// Distance of the centroid from the capsule's axis [m].
    pub distance: f64,
    /// Index among the near triangles.
    pub place: u32,
}

impl Facet {
    /// Triangle with moving corners, relative to a capsule about `axis`.
    #[inline(always)]
    pub fn new(place: u32, [a, b, c]: [(DVec3, DVec3); 3], axis: &Axis) -> Self {
        let center = (a.0 + b.0 + c.0) / 3.0;
        let square = |corner: DVec3| (corner - center).length_squared();
        Facet {
            corners: [a.0, b.0, c.0],
            velocity: (a.1 + b.1 + c.1) / 3.0,
            reach: max(square(a.0), max(square(b.0), square(c.0))).sqrt(),
            distance: (center - axis.nearest(center)).length(),
            place,
        }
    }
}

/// Capsule at one instant, indenting triangles.
pub struct Indenter {
    pressing: Pressing,
    /// Maximum change of depth within a piece [m].
    steep: f64,
    /// Minimum size of a piece [m].
    finest: f64,
}

/// Triangle that is being divided.
struct Cut<'a> {
    facet: &'a Facet,
    /// Normal into the lumen.
    normal: DVec3,
}

impl Indenter {
    /// Indenter of the capsule `body` in motion `m`.
    pub fn new(foundation: &WinklerFoundation, body: &Body, motion: &Motion) -> Self {
        Indenter {
            pressing: Pressing {
                foundation: *foundation,
                radius: body.radius,
                axis: body.axis(motion),
                motion: *motion,
            },
            steep: STEEPNESS * foundation.stiffening_depth,
            finest: FINEST * body.radius,
        }
    }

    /// Fills the patch with the loads of the triangles.
    pub fn press(&mut self, facets: &[Facet], patch: &mut Patch) {
        patch.clear();
        let radius = self.pressing.radius;
        let deepest = facets.iter().fold(0.0, |depth, facet| max(depth, radius - facet.distance));
        self.finest = max(FINEST * radius, FINER * (2.0 * radius * deepest).sqrt());
        for facet in facets {
            let [a, b, c] = facet.corners;
            let cross = (b - a).cross(c - a);
            let twice_area = cross.length();
            if twice_area > 0.0 {
                let cut = Cut { facet, normal: cross / twice_area };
                self.divide(&cut, facet.corners, facet.reach, 0.5 * twice_area, patch);
            }
        }
        patch.press(&self.pressing);
    }

    /// Adds a piece to the patch if it may be in contact, divided into four if it is too coarse.
    fn divide(&self, cut: &Cut, corners: [DVec3; 3], reach: f64, area: f64, patch: &mut Patch) {
        let [a, b, c] = corners;
        let axis: &Axis = &self.pressing.axis;
        let center = (a + b + c) / 3.0;
        let offset = center - axis.nearest(center);
        let distance = offset.length();
        if distance - reach >= self.pressing.radius {
            return;
        }
        let facing = -offset.dot(cut.normal) / distance.max(f64::MIN_POSITIVE);
        let sine = (1.0 - facing * facing).max(0.0).sqrt();
        // Distance is convex: no point of the piece is nearer than this.
        if distance - reach * sine >= self.pressing.radius {
            return;
        }
        if self.is_coarse(reach, distance, sine) {
            let [ab, bc, ca] = [0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)];
            for quarter in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]] {
                self.divide(cut, quarter, 0.5 * reach, 0.25 * area, patch);
            }
            return;
        }
        let (pieces, lane) = patch.piece(cut.facet.place);
        for (k, corner) in corners.into_iter().enumerate() {
            put(&mut pieces.corners[k], lane, corner);
        }
        put(&mut pieces.normal, lane, cut.normal);
        put(&mut pieces.velocity, lane, cut.facet.velocity);
        pieces.area[lane] = area;
    }

    /// True if a piece must be divided: compares it with the radius of the patch, which for a flat
    /// wall is R sin θ at its edge, and with the gradient of the depth.
    fn is_coarse(&self, reach: f64, distance: f64, sine: f64) -> bool {
        let radius = self.pressing.radius;
        if reach <= self.finest {
            return false;
        }
        let change = reach * sine;
        if reach > COARSEST * radius || change > self.steep {
            return true;
        }
        let depth = radius - distance;
        let is_whole = depth >= change + reach * reach / (2.0 * radius);
        !is_whole && reach > FINENESS * radius * sine && reach * reach > FLATNESS * radius * depth
    }
}
