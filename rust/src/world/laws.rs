//! Laws between the capsule, the wall and what fills the lumen: stiffness and resistance.

use crate::tissue::drag::Drag;
use crate::tissue::winkler_foundation::WinklerFoundation;

/// Laws that hold between capsule, wall and what fills the lumen.
#[derive(Clone, Copy)]
pub struct Laws {
    /// Stiffness of the wall.
    pub foundation: WinklerFoundation,
    /// Law of resistance.
    pub drag: Drag,
    /// Viscous coefficient γ of the mucus [N·s/m].
    pub viscosity: f64,
    /// One over the time τ in which what fills the lumen takes a capsule's momentum [1/s].
    pub relaxation_rate: f64,
}

impl Laws {
    /// Whether the wall resists sliding.
    pub fn resist(&self) -> bool {
        self.drag.friction() != 0.0 || self.viscosity != 0.0 || self.drag.is_logarithmic()
    }
}
