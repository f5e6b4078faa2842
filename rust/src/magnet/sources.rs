//! Sources of a magnetic field, in any combination, and the wrench on a body with magnets.

use super::axial::{Ring, Shell};
use super::field_map::FieldMap;
use super::solids::{across, ball, block, is_on_edge};
use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::PI;
use std::sync::Arc;

/// Magnetic constant μ₀ [N/A²] (CODATA 2022).
pub const MAGNETIC_CONSTANT: f64 = 1.256_637_061_27e-6;
/// Distance below which a point is in a dipole [m].
const DIPOLE_SIZE: f64 = 1e-6;

/// Kind of a source, in its own frame: +z along its moment.
#[derive(Clone)]
pub enum Kind {
    /// Point dipole of a moment [A·m²].
    Dipole(f64),
    /// Cylinder magnetized along its axis, or a thin solenoid.
    Shell(Shell),
    /// Ring magnetized along its axis: the outer cylinder minus its hole.
    Tube(Shell, Shell),
    /// Cylinder or ring magnetized across its axis, which is x; the second shell is the hole.
    Across(Shell, Option<Shell>),
    /// Block of half edges [m] and a remanence [T], magnetized along its z.
    Block(DVec3, f64),
    /// Ball of a radius [m] and a remanence [T].
    Ball(f64, f64),
    /// Current loop.
    Ring(Ring),
    /// Uniform flux density [T].
    Uniform(f64),
    /// Sampled field, times a factor.
    Map(Arc<FieldMap>, f64),
}

/// Source at a pose.
#[derive(Clone)]
pub struct Source {
    /// Kind of the source.
    pub kind: Kind,
    /// Rotation from the source's frame to the world.
    pub rotation: DMat3,
    /// Position in the world [m].
    pub position: DVec3,
    /// Factor of the field.
    pub strength: f64,
    /// Radius and half the length of a solid magnet [m], which other bodies cannot penetrate.
    pub solid: Option<(f64, f64)>,
}

/// Validity of a field at a point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// Exact field.
    #[default]
    Regular,
    /// Point outside a field map: the value at its edge is used.
    OutsideMap,
    /// Point in a dipole, on a wire or on the rim of a magnet, where the field is undefined: a
    /// dipole contributes zero, a wire or rim its field at 1e-9 of its size.
    Singular,
}

/// Magnetic field at a point.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Flux density [T].
    pub flux: DVec3,
    /// Gradient `∂B_i/∂x_j` [T/m], row i, column j.
    pub gradient: DMat3,
    /// Validity of the field.
    pub place: Place,
}

/// Magnet fixed in a body, as a dipole.
#[derive(Clone, Copy)]
pub struct InternalMagnet {
    /// Position in the body's frame [m].
    pub position: DVec3,
    /// Moment in the body's frame [A·m²].
    pub moment: DVec3,
}

/// Force and torque on a body, and validity of the field there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wrench {
    /// Force [N], in the world.
    pub force: DVec3,
    /// Torque about the body's origin [N·m], in the world.
    pub torque: DVec3,
    /// Worst validity of the field at its magnets.
    pub place: Place,
    /// Maximum torque [N·m] of the field there on them, the sum of |m| |B|.
    pub hold: f64,
}

/// Field of a dipole: `B = μ₀/4π (3 (m·r̂) r̂ − m)/r³`, and its gradient
/// `3μ₀/4πr⁴ (m r̂ᵀ + r̂ mᵀ + (m·r̂)(1 − 5 r̂ r̂ᵀ))` (Jackson 1999, eq. 5.56).
pub fn dipole(moment: f64, p: DVec3) -> (DVec3, DMat3, Place) {
    let r2 = p.length_squared();
    if r2 < DIPOLE_SIZE * DIPOLE_SIZE {
        return (DVec3::ZERO, DMat3::ZERO, Place::Singular);
    }
    let over = 1.0 / r2.sqrt();
    let n = p * over;
    let cube = MAGNETIC_CONSTANT / (4.0 * PI) * moment * over * over * over;
    let flux = cube * (3.0 * n.z * n - DVec3::Z);
    let outer = DMat3::from_cols(n * n.x, n * n.y, n * n.z);
    let along = DMat3::from_cols(DVec3::ZERO, DVec3::ZERO, n);
    let bend = n.z * (DMat3::IDENTITY - 5.0 * outer);
    (flux, 3.0 * cube * over * (along + along.transpose() + bend), Place::Regular)
}

impl Source {
    /// Field of this source at a point of the world.
    #[inline]
    pub fn field(&self, point: DVec3) -> Field {
        let p = self.rotation.transpose() * (point - self.position);
        let rho2 = p.x * p.x + p.y * p.y;
        let rho = rho2.sqrt();
        let singular =
            |is_singular: bool| if is_singular { Place::Singular } else { Place::Regular };
        let (flux, gradient, place) = match &self.kind {
            Kind::Dipole(moment) => dipole(*moment, p),
            Kind::Shell(shell) => {
                let (flux, gradient) = shell.field(rho, p.z).at(p, rho2);
                (flux, gradient, singular(shell.is_singular(rho, p.z)))
            }
            Kind::Tube(outer, hole) => {
                let ((flux, gradient), (less, slope)) =
                    (outer.field(rho, p.z).at(p, rho2), hole.field(rho, p.z).at(p, rho2));
                let is_on_rim = outer.is_singular(rho, p.z) || hole.is_singular(rho, p.z);
                (flux - less, gradient - slope, singular(is_on_rim))
            }
            Kind::Across(outer, hole) => {
                let (mut flux, mut gradient) = across(outer, p);
                let (around, along) = (p.y.hypot(p.z), p.x);
                let mut is_on_rim = outer.is_singular(around, along);
                if let Some(hole) = hole {
                    let (less, slope) = across(hole, p);
                    (flux, gradient) = (flux - less, gradient - slope);
                    is_on_rim |= hole.is_singular(around, along);
                }
                (flux, gradient, singular(is_on_rim))
            }
            Kind::Block(half, remanence) => {
                let (flux, gradient) = block(*half, *remanence, p);
                (flux, gradient, singular(is_on_edge(*half, p)))
            }
            Kind::Ball(radius, remanence) => {
                let (flux, gradient) = ball(*radius, *remanence, p);
                (flux, gradient, Place::Regular)
            }
            Kind::Ring(ring) => {
                let (flux, gradient) = ring.field(rho, p.z).at(p, rho2);
                (flux, gradient, singular(ring.is_singular(rho, p.z)))
            }
            Kind::Uniform(flux) => (*flux * DVec3::Z, DMat3::ZERO, Place::Regular),
            Kind::Map(map, factor) => {
                let (flux, gradient, is_in) = map.field(p);
                let place = if is_in { Place::Regular } else { Place::OutsideMap };
                (*factor * flux, *factor * gradient, place)
            }
        };
        let turn = self.strength * self.rotation;
        Field { flux: turn * flux, gradient: turn * gradient * self.rotation.transpose(), place }
    }

    /// True if a ball about a point of the world intersects the magnet.
    pub fn cuts(&self, point: DVec3, radius: f64) -> bool {
        self.solid.is_some_and(|(around, half)| {
            let p = self.rotation.transpose() * (point - self.position);
            let rho = (p.x * p.x + p.y * p.y).sqrt();
            let (beside, beyond) = ((rho - around).max(0.0), (p.z.abs() - half).max(0.0));
            beside * beside + beyond * beyond < radius * radius
        })
    }
}

/// Field of all sources at a point, summed in their order.
#[inline]
pub fn field(sources: &[Source], point: DVec3) -> Field {
    let mut sum = Field { flux: DVec3::ZERO, gradient: DMat3::ZERO, place: Place::Regular };
    for source in sources {
        let one = source.field(point);
        sum.flux += one.flux;
        sum.gradient += one.gradient;
        sum.place = sum.place.max(one.place);
    }
    sum
}

/// Wrench of the sources on a body at a pose: `F = ∇(m·B) = Gᵀ m` and `N = m × B + arm × F`, summed
/// over its magnets, each at its position. Allocates nothing.
#[inline]
pub fn wrench(
    sources: &[Source],
    magnets: &[InternalMagnet],
    position: DVec3,
    rotation: DQuat,
) -> Wrench {
    let mut sum = Wrench::default();
    for magnet in magnets {
        let (arm, moment) = (rotation * magnet.position, rotation * magnet.moment);
        let at = field(sources, position + arm);
        let force = at.gradient.transpose() * moment;
        sum.force += force;
        sum.torque += moment.cross(at.flux) + arm.cross(force);
        sum.place = sum.place.max(at.place);
        sum.hold += moment.length() * at.flux.length();
    }
    sum
}
