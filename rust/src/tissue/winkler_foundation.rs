//! Pressure of the wall's thickness against indentation.

use crate::simd::f64x8::{exp_m1, ln, max, min};

/// Foundation that resists the capsule: `vrcaps.tissue.tissue.WinklerFoundation`.
#[derive(Clone, Copy)]
pub struct WinklerFoundation {
    /// Derivative K of pressure by depth at zero depth [Pa/m].
    pub stiffness: f64,
    /// Depth l per e-fold of stiffness [m]; infinite for a linear wall.
    pub stiffening_depth: f64,
    /// Increase g of pressure with the logarithm of the speed of indentation.
    pub rate_gain: f64,
    /// Speed of indentation above which that increase is effective [m/s].
    pub rate: f64,
    /// Depth beyond which a penalty stiffens the wall [m].
    guard: f64,
    /// Stiffness at that depth [Pa/m].
    guard_stiffness: f64,
}

/// Means over a piece of wall.
#[derive(Clone, Copy)]
pub struct Pressure {
    /// Pressure [Pa].
    pub value: f64,
    /// Derivative by depth [Pa/m].
    pub by_depth: f64,
    /// Derivative by speed [Pa·s/m].
    pub by_speed: f64,
    /// Stored energy [J/m²].
    pub energy: f64,
}

/// Number of e-folds beyond which stiffness is constant, so that numbers stay finite.
const MOST_FOLDS: f64 = 25.0;
/// Depth above which the penalty acts, as a fraction of the capsule's radius.
const GUARD: f64 = 0.5;
/// Depth per e-fold of the penalty, as a fraction of the depth above which it acts.
const GUARD_FOLD: f64 = 0.066;

impl WinklerFoundation {
    /// Wall of stiffness, stiffening depth, rate gain and rate, with a penalty against perforation
    /// by a capsule of a radius [m]: beyond half of it, the stiffness grows far faster.
    pub fn new(wall: [f64; 4], radius: f64) -> Self {
        let [stiffness, stiffening_depth, rate_gain, rate] = wall;
        let guard = GUARD * radius;
        let mut made = WinklerFoundation {
            stiffness,
            stiffening_depth,
            rate_gain,
            rate,
            guard,
            guard_stiffness: 0.0,
        };
        made.guard_stiffness = made.elastic(guard, 0.0).by_depth;
        made
    }

    /// Pressure of the penalty: zero above its depth, then `S d (exp(x) − 1 − x)`, with d its depth
    /// per e-fold and x the number of e-folds.
    #[inline(always)]
    fn guard(&self, depth: f64) -> Pressure {
        let fold = GUARD_FOLD * self.guard;
        let x = min(max((depth - self.guard) / fold, 0.0), MOST_FOLDS);
        let growth = exp_m1(x);
        Pressure {
            value: self.guard_stiffness * fold * (growth - x),
            by_depth: self.guard_stiffness * growth,
            by_speed: 0.0,
            energy: self.guard_stiffness * fold * fold * (growth - x - 0.5 * x * x),
        }
    }

    /// Elastic pressure φ, its derivative and its integral: `φ = K l (exp(u/l) − 1)`, exponential
    /// as for soft tissue (Fung, Biomechanics, 1993). Means over depths with mean u and variance V,
    /// to first order in V: `φ + φ″ V/2`.
    #[inline(always)]
    fn elastic(&self, depth: f64, variance: f64) -> Pressure {
        let (k, l) = (self.stiffness, self.stiffening_depth);
        if !l.is_finite() {
            let energy = 0.5 * k * (depth * depth + variance);
            return Pressure { value: k * depth, by_depth: k, by_speed: 0.0, energy };
        }
        let folds = min(depth / l, MOST_FOLDS);
        let (over, growth) = (depth - folds * l, exp_m1(folds));
        let bend = (1.0 + growth) * (variance / (2.0 * l * l));
        let (pressure, slope) = (k * l * (growth + bend), k * (1.0 + growth + bend));
        let energy = k * l * l * (growth - folds + bend);
        Pressure {
            value: pressure + slope * over,
            by_depth: slope,
            by_speed: 0.0,
            energy: energy + (pressure + 0.5 * slope * over) * over,
        }
    }

    /// `p = φ(u) (1 + g asinh(u̇/u̇₀))`, never below 0.
    #[inline(always)]
    pub fn pressure(&self, depth: f64, variance: f64, speed: f64) -> Pressure {
        let (soft, guard) = (self.elastic(depth, variance), self.guard(depth));
        let elastic = Pressure {
            value: soft.value + guard.value,
            by_depth: soft.by_depth + guard.by_depth,
            by_speed: 0.0,
            energy: soft.energy + guard.energy,
        };
        let x = speed / self.rate;
        let root = (1.0 + x * x).sqrt();
        // Plain formula of asinh: its error for tiny x is negligible relative to 1.
        let factor = max(1.0 + self.rate_gain * ln(x.abs() + root).copysign(x), 0.0);
        let by_speed = elastic.value * self.rate_gain / (self.rate * root);
        Pressure {
            value: elastic.value * factor,
            by_depth: elastic.by_depth * factor,
            by_speed: if factor > 0.0 { by_speed } else { 0.0 },
            energy: elastic.energy,
        }
    }
}
