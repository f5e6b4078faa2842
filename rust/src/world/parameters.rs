//! Parameters of a world, extracted from Python objects.

use super::body::Body;
use super::laws::Laws;
use super::solve::Twist;
use super::substep::Load;
use super::time_stepping::Dynamics;
use crate::poses::{three_rows, vector};
use crate::tissue::drag::{Drag, LogLaw};
use crate::tissue::spring_wall::SpringWall;
use crate::tissue::winkler_foundation::WinklerFoundation;
use glam::{DMat3, DQuat, DVec3};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Body of a capsule: `vrcaps.capsule.device.Body`.
#[derive(FromPyObject)]
pub struct BodyParameters<'py> {
    mass: f64,
    inertia: PyReadonlyArray2<'py, f64>,
    center: PyReadonlyArray1<'py, f64>,
    half_axis: f64,
    radius: f64,
}

/// Pressure of the wall: `vrcaps.tissue.tissue.WinklerFoundation`.
#[derive(FromPyObject)]
pub struct FoundationParameters {
    stiffness: f64,
    stiffening_depth: f64,
    rate_gain: f64,
    rate: f64,
}

/// Resistance of the wall: `vrcaps.tissue.tissue.Drag`.
#[derive(FromPyObject)]
pub struct DragParameters {
    law: String,
    friction: f64,
    viscosity: f64,
    a: f64,
    b: f64,
    c: f64,
    constant: f64,
    threshold: f64,
    relaxation_time: Option<f64>,
}

/// Default time τ in which a capsule in quasi-static motion loses its momentum [s].
const QUASI_STATIC_RELAXATION: f64 = 0.1;

/// Spring wall: `vrcaps.tissue.tissue.SpringWall`.
#[derive(FromPyObject)]
pub struct SpringWallParameters {
    length: f64,
    reach: f64,
    mass: f64,
    stiffness: f64,
    damping: f64,
}

/// Laws between a capsule of a radius [m], the wall and the lumen contents.
pub fn laws(
    foundation: FoundationParameters,
    drag: DragParameters,
    radius: f64,
    dynamics: Dynamics,
) -> Laws {
    let usual = match dynamics {
        Dynamics::Physics => f64::INFINITY,
        Dynamics::QuasiStatic => QUASI_STATIC_RELAXATION,
    };
    let law = LogLaw {
        a: drag.a,
        b: drag.b,
        c: drag.c,
        constant: drag.constant,
        threshold: drag.threshold,
    };
    Laws {
        foundation: WinklerFoundation::new(
            [
                foundation.stiffness,
                foundation.stiffening_depth,
                foundation.rate_gain,
                foundation.rate,
            ],
            radius,
        ),
        drag: match drag.law.as_str() {
            "incetan2021" => Drag::Printed(law),
            "continuous" => Drag::Continuous(law),
            _ => Drag::Physical { friction: drag.friction },
        },
        viscosity: drag.viscosity,
        relaxation_rate: 1.0 / drag.relaxation_time.unwrap_or(usual),
    }
}

/// Count of numbers of a load.
pub const LOAD_ROW: usize = 10;

/// Load from a row of force, torque, gravity and damping.
pub fn load(row: &[f64]) -> Load {
    let wrench = Twist { linear: vector(row), angular: vector(&row[3..]) };
    Load { wrench, gravity: vector(&row[6..]), damping: row[9] }
}

impl From<SpringWallParameters> for SpringWall {
    fn from(q: SpringWallParameters) -> Self {
        SpringWall {
            length: q.length,
            reach: q.reach,
            mass: q.mass,
            spring: q.stiffness,
            damping: q.damping,
        }
    }
}

impl TryFrom<BodyParameters<'_>> for Body {
    type Error = PyErr;

    fn try_from(p: BodyParameters) -> PyResult<Self> {
        let (inertia, center) = (three_rows(&p.inertia)?.transpose(), p.center.as_array());
        if center.len() != 3 {
            return Err(PyValueError::new_err("The center of a body needs three numbers."));
        }
        let (moments, axes) = principal_axes(inertia);
        Ok(Body {
            mass: p.mass,
            moments,
            principal: DQuat::from_mat3(&axes),
            center: DVec3::new(center[0], center[1], center[2]),
            half_axis: p.half_axis,
            radius: p.radius,
        })
    }
}

/// Eigenvalues and right-handed eigenvectors of a symmetric matrix, by Jacobi rotations.
pub fn principal_axes(mut a: DMat3) -> (DVec3, DMat3) {
    let mut axes = DMat3::IDENTITY;
    for _ in 0..32 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let off = a.col(q)[p];
            if off == 0.0 {
                continue;
            }
            let theta = 0.5 * (a.col(q)[q] - a.col(p)[p]) / off;
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(p)[p] = c;
            turn.col_mut(q)[q] = c;
            turn.col_mut(q)[p] = t * c;
            turn.col_mut(p)[q] = -t * c;
            a = turn.transpose() * a * turn;
            axes *= turn;
        }
    }
    (DVec3::new(a.x_axis.x, a.y_axis.y, a.z_axis.z), axes)
}
