//! Surroundings of the spheres in one step, as passed by Python.

use super::capsule::Capsule;
use glam::{DQuat, DVec3};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

/// Surroundings of the spheres in one step; positions are relative to the wall's center.
#[derive(FromPyObject)]
pub struct StepInputs<'py> {
    /// Unit direction against gravity.
    up: [f64; 3],
    /// Gravitational acceleration [m/s²].
    gravity: f64,
    /// Section [p 2] of each pool along the gut, and its level along `up` [m].
    stretch: PyReadonlyArray2<'py, f64>,
    levels: PyReadonlyArray1<'py, f64>,
    /// Ends of the capsule's axis [m].
    axis: [[f64; 3]; 2],
    radius: f64,
    mass: f64,
    center: [f64; 3],
    wxyz: [f64; 4],
    velocity: [f64; 3],
    spin: [f64; 3],
}

/// Gravity and pools.
pub struct Around {
    /// Unit direction against gravity.
    pub up: DVec3,
    /// Gravitational acceleration [m/s²].
    pub gravity: f64,
    /// Section of each pool along the gut, and its level along `up` [m].
    pools: Vec<([f64; 2], f64)>,
}

impl StepInputs<'_> {
    /// Reads gravity and pools.
    pub fn read(&self) -> Around {
        let (stretch, levels) = (self.stretch.as_array(), self.levels.as_array());
        Around {
            up: DVec3::from_array(self.up),
            gravity: self.gravity,
            pools: stretch.outer_iter().zip(levels).map(|(s, &z)| ([s[0], s[1]], z)).collect(),
        }
    }

    /// The capsule before any collision.
    pub fn capsule(&self) -> Capsule {
        let [w, x, y, z] = self.wxyz;
        Capsule {
            ends: self.axis.map(DVec3::from_array),
            radius: self.radius,
            mass: self.mass,
            center: DVec3::from_array(self.center),
            rotation: DQuat::from_xyzw(x, y, z, w),
            velocity: DVec3::from_array(self.velocity),
            spin: DVec3::from_array(self.spin),
            impulse: DVec3::ZERO,
            moment: DVec3::ZERO,
        }
    }
}

impl Around {
    /// Level of the pool at an arc length along the gut [m].
    pub fn level(&self, arc_length: f64) -> Option<f64> {
        let holds = |stretch: &[f64; 2]| (stretch[0]..=stretch[1]).contains(&arc_length);
        self.pools.iter().find(|(stretch, _)| holds(stretch)).map(|(_, level)| *level)
    }
}
