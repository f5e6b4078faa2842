//! Laws between capsule, wall and lumen contents: stiffness and resistance.

use crate::tissue::drag::Drag;
use crate::tissue::winkler_foundation::WinklerFoundation;

/// Laws between capsule, wall and lumen contents.
#[derive(Clone, Copy)]
pub struct Laws {
    /// Stiffness of the wall.
    pub foundation: WinklerFoundation,
    /// Law of resistance.
    pub drag: Drag,
    /// Viscous coefficient γ of the mucus [N·s/m].
    pub viscosity: f64,
    /// Inverse of the time τ in which the lumen contents absorb a capsule's momentum [1/s].
    pub relaxation_rate: f64,
}

impl Laws {
    /// True if the wall resists sliding.
    pub fn resist(&self) -> bool {
        self.drag.friction() != 0.0 || self.viscosity != 0.0 || self.drag.is_logarithmic()
    }
}
