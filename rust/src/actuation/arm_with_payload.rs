//! Arm with a magnet at its flange, above a table: `vrcaps.actuation.arm.arm_with_payload`.

use super::arm_chain::{ArmChain, array, pose};
use super::kinematic_chain::Pose;
use super::link_capsules::Obstacles;
use crate::poses::{rows, square};
use glam::DVec3;
use numpy::{PyArrayDyn, PyReadonlyArray2};
use pyo3::prelude::*;

/// Python handle of the arm and its magnet.
#[pyclass(module = "vrcaps._core")]
#[derive(Clone)]
pub struct ArmWithPayload {
    /// Arm, with a capsule that holds the magnet.
    pub arm: ArmChain,
    /// Links alone, for the distance to the table: relative to it, the magnet is a cylinder.
    bare: Obstacles,
    /// Pose of the base in the world, and of the magnet in the flange.
    base: Pose,
    mount: Pose,
    /// Diameter and length of the magnet [m].
    size: (f64, f64),
    /// Height of the table in the world [m].
    table: Option<f64>,
}

impl ArmWithPayload {
    /// Pose of the magnet in the world, given the arm's frames.
    pub fn magnet(&self, frames: &[Pose]) -> Pose {
        self.base.then(&frames[frames.len() - 1]).then(&self.mount)
    }

    /// Direction of the flange in the magnet.
    pub fn flange_along(&self) -> DVec3 {
        self.mount.inverse().rotation.z_axis
    }

    /// Joint angles nearest to `near` for a pose of the magnet in the world, see `ArmChain::solve`.
    pub fn solve(&self, magnet: &Pose, near: &[f64], others: &[f64]) -> Option<Vec<f64>> {
        let flange = self.base.inverse().then(magnet).then(&self.mount.inverse());
        self.arm.solve(&flange, near, others)
    }

    /// Minimum distances [m] of links and magnet to each other, and to the table.
    pub fn gaps(&self, frames: &[Pose]) -> (f64, f64) {
        let own = self.arm.obstacles.clearance(frames).0;
        let Some(table) = self.table else { return (own, f64::INFINITY) };
        let links = self.bare.clearance(frames).1;
        (own, links.min(self.height(&self.magnet(frames)) - table))
    }

    /// Height [m] of the magnet's lowest point.
    fn height(&self, magnet: &Pose) -> f64 {
        let upright = magnet.rotation.z_axis.z.abs();
        let flat = (1.0 - upright * upright).max(0.0).sqrt();
        magnet.position.z - 0.5 * (self.size.1 * upright + self.size.0 * flat)
    }
}

#[pymethods]
impl ArmWithPayload {
    /// Arm with a payload, from the arm alone and with a capsule for the magnet, the poses [4 4] of
    /// its base in the world and of the magnet in the flange, the magnet's diameter and length [m],
    /// the table's height [m].
    #[new]
    fn new(
        arm: PyRef<'_, ArmChain>,
        loaded: PyRef<'_, ArmChain>,
        base: PyReadonlyArray2<'_, f64>,
        mount: PyReadonlyArray2<'_, f64>,
        size: (f64, f64),
        table: Option<f64>,
    ) -> PyResult<Self> {
        let (base, mount) = (pose(&square(&base, 4)?), pose(&square(&mount, 4)?));
        let up = base.inverse();
        let plane = table
            .map(|height| (up.rotation * (height * DVec3::Z) + up.position, up.rotation.z_axis));
        let bare = Obstacles { pairs: vec![], table: plane, ..arm.obstacles.clone() };
        Ok(ArmWithPayload { arm: loaded.clone(), bare, base, mount, size, table })
    }

    /// Minimum distances [k 2] as by `gaps`, for angles [k n].
    fn clearance<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let n = self.arm.count();
        let angles = rows(&angles, n)?;
        let mut frames = Vec::new();
        let mut flat = Vec::with_capacity(2 * angles.len() / n);
        for q in angles.chunks_exact(n) {
            self.arm.chain.frames(q, &mut frames);
            flat.extend(<[f64; 2]>::from(self.gaps(&frames)));
        }
        array(py, &[angles.len() / n, 2], flat)
    }

    /// Height [m] of the lowest point of the magnet at a pose [4 4].
    fn lowest(&self, magnet: PyReadonlyArray2<'_, f64>) -> PyResult<f64> {
        Ok(self.height(&pose(&square(&magnet, 4)?)))
    }
}
