//! State of the coupling between a capsule and a layer that persists between steps.

use glam::DVec3;

/// Force on one triangle of the wall in the last substep.
#[derive(Clone, Copy, Default)]
pub struct ContactFace {
    /// Index of the triangle.
    pub face: u32,
    /// Normal force [N].
    pub normal: f64,
    /// Friction on the wall [N].
    pub tangent: DVec3,
}

/// State of the coupling, in addition to the layer's own motion.
#[derive(Clone, Default)]
pub struct CouplingState {
    /// Forces on the layer's nodes in the last substep [N].
    pub force: Vec<DVec3>,
    /// Offset of the wall that the capsule felt from the layer at the end of the last step [m];
    /// zero for a linear layer.
    pub offset: Vec<DVec3>,
    /// Deferred momentum, to be applied to the layer in its next step [N·s].
    pub owed: Vec<DVec3>,
    /// Forces in the last substep, by ascending index of the triangle.
    pub touched: Vec<ContactFace>,
}

impl CouplingState {
    /// State for a layer of `count` nodes at rest.
    pub fn at_rest(count: usize) -> Self {
        let zero = vec![DVec3::ZERO; count];
        CouplingState { force: zero.clone(), offset: zero.clone(), owed: zero, touched: Vec::new() }
    }

    /// Rows of nine for each node, and of five for each triangle in contact.
    pub fn to_rows(&self) -> (Vec<f64>, Vec<f64>) {
        let vectors = |k: usize| [self.force[k], self.offset[k], self.owed[k]];
        let node = |k| vectors(k).into_iter().flat_map(|v| v.to_array());
        let touch =
            |t: &ContactFace| [f64::from(t.face), t.normal, t.tangent.x, t.tangent.y, t.tangent.z];
        let nodes = (0..self.force.len()).flat_map(node).collect();
        (nodes, self.touched.iter().flat_map(touch).collect())
    }

    /// State from the rows of `to_rows`.
    pub fn from_rows(nodes: &[f64], touched: &[f64]) -> Self {
        let vectors = |skip: usize| {
            nodes.chunks_exact(9).map(|row| DVec3::from_slice(&row[skip..])).collect()
        };
        let touch = |row: &[f64]| ContactFace {
            face: row[0] as u32,
            normal: row[1],
            tangent: DVec3::from_slice(&row[2..]),
        };
        CouplingState {
            force: vectors(0),
            offset: vectors(3),
            owed: vectors(6),
            touched: touched.chunks_exact(5).map(touch).collect(),
        }
    }
}
