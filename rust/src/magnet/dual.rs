//! Number types of the closed forms: pairs of lanes, and dual numbers.

use std::ops::{Add, Div, Mul, Sub};

/// Arithmetic of the closed forms.
pub trait Number:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Add<f64, Output = Self>
    + Mul<f64, Output = Self>
{
    /// Number from a constant.
    fn constant(x: f64) -> Self;
    /// Square root of a positive number.
    fn sqrt(self) -> Self;
    /// True if every lane's value differs from `other`'s by at most the fraction `part` of it.
    fn is_close(self, other: Self, part: f64) -> bool;
    /// Selects `small` where a lane of `key` is below `limit`, else `large`.
    fn choose(key: Self, limit: f64, small: Self, large: Self) -> Self;
    /// Maximum of the number and `least`.
    fn at_least(self, least: f64) -> Self {
        Self::choose(self, least, Self::constant(least), self)
    }
}

/// Two numbers in SIMD lanes: the two ends of a magnet.
#[derive(Clone, Copy, Debug)]
pub struct Pair(pub [f64; 2]);

/// Dual number: a value and its derivative (forward-mode automatic differentiation).
#[derive(Clone, Copy, Debug)]
pub struct Dual {
    /// Value.
    pub value: f64,
    /// Derivative.
    pub slope: f64,
}

macro_rules! pair_operator {
    ($name:ident, $method:ident, $sign:tt) => {
        impl $name for Pair {
            type Output = Pair;
            #[inline(always)]
            fn $method(self, other: Pair) -> Pair {
                Pair([self.0[0] $sign other.0[0], self.0[1] $sign other.0[1]])
            }
        }
    };
}
pair_operator!(Add, add, +);
pair_operator!(Sub, sub, -);
pair_operator!(Mul, mul, *);
pair_operator!(Div, div, /);

impl Add<f64> for Pair {
    type Output = Pair;
    #[inline(always)]
    fn add(self, other: f64) -> Pair {
        Pair([self.0[0] + other, self.0[1] + other])
    }
}

impl Mul<f64> for Pair {
    type Output = Pair;
    #[inline(always)]
    fn mul(self, other: f64) -> Pair {
        Pair([self.0[0] * other, self.0[1] * other])
    }
}

impl Number for Pair {
    #[inline(always)]
    fn constant(x: f64) -> Pair {
        Pair([x; 2])
    }
    #[inline(always)]
    fn sqrt(self) -> Pair {
        Pair([self.0[0].sqrt(), self.0[1].sqrt()])
    }
    #[inline(always)]
    fn is_close(self, other: Pair, part: f64) -> bool {
        let close = |i: usize| (self.0[i] - other.0[i]).abs() <= part * other.0[i];
        close(0) && close(1)
    }
    #[inline(always)]
    fn choose(key: Pair, limit: f64, small: Pair, large: Pair) -> Pair {
        let lane = |i: usize| if key.0[i] < limit { small.0[i] } else { large.0[i] };
        Pair([lane(0), lane(1)])
    }
}

impl Add for Dual {
    type Output = Dual;
    #[inline(always)]
    fn add(self, other: Dual) -> Dual {
        Dual { value: self.value + other.value, slope: self.slope + other.slope }
    }
}

impl Sub for Dual {
    type Output = Dual;
    #[inline(always)]
    fn sub(self, other: Dual) -> Dual {
        Dual { value: self.value - other.value, slope: self.slope - other.slope }
    }
}

impl Mul for Dual {
    type Output = Dual;
    #[inline(always)]
    fn mul(self, other: Dual) -> Dual {
        Dual {
            value: self.value * other.value,
            slope: self.slope * other.value + self.value * other.slope,
        }
    }
}

impl Div for Dual {
    type Output = Dual;
    #[inline(always)]
    fn div(self, other: Dual) -> Dual {
        let value = self.value / other.value;
        Dual { value, slope: (self.slope - value * other.slope) / other.value }
    }
}

impl Add<f64> for Dual {
    type Output = Dual;
    #[inline(always)]
    fn add(self, other: f64) -> Dual {
        Dual { value: self.value + other, slope: self.slope }
    }
}

impl Mul<f64> for Dual {
    type Output = Dual;
    #[inline(always)]
    fn mul(self, other: f64) -> Dual {
        Dual { value: self.value * other, slope: self.slope * other }
    }
}

impl Number for Dual {
    #[inline(always)]
    fn constant(x: f64) -> Dual {
        Dual { value: x, slope: 0.0 }
    }
    #[inline(always)]
    fn sqrt(self) -> Dual {
        let value = self.value.sqrt();
        Dual { value, slope: 0.5 * self.slope / value }
    }
    #[inline(always)]
    fn is_close(self, other: Dual, part: f64) -> bool {
        (self.value - other.value).abs() <= part * other.value
    }
    #[inline(always)]
    fn choose(key: Dual, limit: f64, small: Dual, large: Dual) -> Dual {
        if key.value < limit { small } else { large }
    }
}
