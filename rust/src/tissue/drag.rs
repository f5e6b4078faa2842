//! Resistance of the gut to a moving capsule, by three laws.

use crate::simd::f64x8::ln;

/// Parameters of the logarithmic law as published: `f = a ln(b v + c) + C`, in mN and mm/s (Incetan
/// et al., Med. Image Anal. 70, 2021, fitted to Zhang et al., Tribol. Lett. 2012).
#[derive(Clone, Copy)]
pub struct LogLaw {
    /// Factor a [N].
    pub a: f64,
    /// Factor b [s/m].
    pub b: f64,
    /// Offset c.
    pub c: f64,
    /// Resistance C at rest [N].
    pub constant: f64,
    /// Speed up to which the published law stays at C [m/s].
    pub threshold: f64,
}

/// Law of resistance, with its parameters.
#[derive(Clone, Copy)]
pub enum Drag {
    /// Law as published: C up to the threshold, then the logarithm, with a jump between them.
    Printed(LogLaw),
    /// Logarithm at every speed, without a jump.
    Continuous(LogLaw),
    /// Coulomb friction and viscous drag; the contact adds the resistance of the stretched wall.
    Physical {
        /// Coefficient of friction μ.
        friction: f64,
    },
}

impl Drag {
    /// Resistance [N] of the two logarithmic laws at a speed [m/s]; 0 for the physical law.
    pub fn resistance(&self, speed: f64) -> f64 {
        let logarithm = |law: &LogLaw| law.a * ln(law.b * speed + law.c) + law.constant;
        match self {
            Drag::Printed(law) if speed <= law.threshold => law.constant,
            Drag::Printed(law) | Drag::Continuous(law) => logarithm(law),
            Drag::Physical { .. } => 0.0,
        }
    }

    /// Derivative of the resistance by speed [N·s/m]; ignores the jump of the published law.
    pub fn slope(&self, speed: f64) -> f64 {
        match self {
            Drag::Printed(law) if speed <= law.threshold => 0.0,
            Drag::Printed(law) | Drag::Continuous(law) => law.a * law.b / (law.b * speed + law.c),
            Drag::Physical { .. } => 0.0,
        }
    }

    /// True if the law is one of the two logarithmic ones.
    pub fn is_logarithmic(&self) -> bool {
        !matches!(self, Drag::Physical { .. })
    }

    /// Coefficient of Coulomb friction.
    pub fn friction(&self) -> f64 {
        if let Drag::Physical { friction } = self { *friction } else { 0.0 }
    }
}
