//! Ray marching through a clump to the intersections with its surface.

use super::field::PEAK;
use super::nearby::{Clump, Span};
use super::rays::Beams;
use crate::simd::f32x64::*;

/// Step length as a fraction of the distance at which the field would reach 1 if it rose at its
/// maximum rate; the surface is then between two steps.
const STRIDE: f32 = 1.8;
/// First step from a point where the field is 0, as a fraction of the reach.
const FIRST_STEP: f32 = STRIDE / (2.0 * PEAK);
/// Minimum step as a fraction of the reach: thinner parts along a ray may be missed.
const LEAST_STEP: f32 = 0.1;
/// Minimum distance of a surface from the start of a ray, as a fraction of the reach.
const CLEAR: f32 = 0.02;
/// Maximum number of steps of a ray through a clump.
const STEPS: usize = 64;
/// Iterations between two steps; the distance is then accurate to 1e-6 of a reach.
const REFINEMENTS: usize = 5;

/// Rays that cross the surface between two steps, and N − 1 at both.
struct Bracket<const N: usize> {
    low: [f32; N],
    high: [f32; N],
    values: [[f32; N]; 2],
}

/// State of rays in a clump.
struct March<const N: usize> {
    /// Current distances [m].
    way: [f32; N],
    going: [bool; N],
    met: [bool; N],
    found: Bracket<N>,
}

impl Clump {
    /// Distances at which rays hit the surface from outside, nearer than `until` [m]; infinity
    /// without a hit. With `ANY` only the existence of a hit is computed.
    #[inline(always)]
    pub fn meet<const N: usize, const ANY: bool>(
        &self,
        beams: &Beams<'_, N>,
        span: &Span<N>,
    ) -> [f32; N] {
        let mut march = March::begin(beams, span);
        for _ in 0..STEPS {
            if !march.going.contains(&true) {
                break;
            }
            let (squares, slopes) = self.field(beams, &march.way, &march.going);
            let mut onward = march.look(&squares, &slopes, span);
            if (0..N).any(|i| march.going[i] & (squares[i] == 0.0)) {
                let next = self.next(beams, &march.way);
                for i in 0..N {
                    let far = max(onward[i], next[i] + FIRST_STEP * span.finest[i]);
                    onward[i] = if squares[i] == 0.0 { far } else { onward[i] };
                }
            }
            for i in 0..N {
                let on = min(onward[i], span.leave[i]);
                march.way[i] = if march.going[i] { on } else { march.way[i] };
            }
        }
        let March { met, found, .. } = march;
        let ways =
            if ANY || !met.contains(&true) { found.low } else { self.refine(beams, &met, found) };
        std::array::from_fn(|i| if met[i] { ways[i] } else { f32::INFINITY })
    }

    /// Distances at which rays cross the surface within a bracket [m] (Illinois method, Dowell and
    /// Jarratt, BIT 11, 1971).
    #[inline(always)]
    fn refine<const N: usize>(
        &self,
        beams: &Beams<'_, N>,
        met: &[bool; N],
        mut found: Bracket<N>,
    ) -> [f32; N] {
        let mut side = [0.0f32; N];
        for _ in 0..REFINEMENTS {
            let way = found.crossing();
            let (squares, _) = self.field(beams, &way, met);
            let Bracket { low, high, values: [below, above] } = &mut found;
            for i in 0..N {
                let value = squares[i].sqrt() - 1.0;
                let is_outside = value < 0.0;
                let (half_above, half_below) =
                    (is_outside & (side[i] < 0.0), !is_outside & (side[i] > 0.0));
                above[i] *= if half_above { 0.5 } else { 1.0 };
                below[i] *= if half_below { 0.5 } else { 1.0 };
                low[i] = if is_outside { way[i] } else { low[i] };
                below[i] = if is_outside { value } else { below[i] };
                high[i] = if is_outside { high[i] } else { way[i] };
                above[i] = if is_outside { above[i] } else { value };
                side[i] = if is_outside { -1.0 } else { 1.0 };
            }
        }
        found.crossing()
    }
}

impl<const N: usize> March<N> {
    /// Starts rays where they come within reach.
    #[inline(always)]
    fn begin(beams: &Beams<'_, N>, span: &Span<N>) -> Self {
        let mut found = Bracket { low: span.enter, high: span.enter, values: [[1.0; N]; 2] };
        let mut way = [0.0; N];
        for i in 0..N {
            // A ray that comes within reach from elsewhere starts at a field of 0.
            let is_outside = span.enter[i] > beams.from[i];
            found.values[0][i] = if is_outside { -1.0 } else { 1.0 };
            let first = if is_outside { FIRST_STEP } else { CLEAR };
            way[i] = min(span.enter[i] + first * span.finest[i], span.leave[i]);
        }
        let going = std::array::from_fn(|i| span.enter[i] < span.leave[i]);
        March { way, going, met: [false; N], found }
    }

    /// Evaluates Σ vᵢ² and Σ vᵢ/Rᵢ at the current distances; returns the next step lengths [m].
    #[inline(always)]
    fn look(&mut self, squares: &[f32; N], slopes: &[f32; N], span: &Span<N>) -> [f32; N] {
        let March { way, going, met, found: Bracket { low, high, values: [below, above] } } = self;
        let mut onward = *way;
        for i in 0..N {
            let value = squares[i].sqrt();
            let step = FIRST_STEP * (1.0 - value) * value / max(slopes[i], 1e-20);
            onward[i] += max(step, LEAST_STEP * span.finest[i]);
            // From outside: the previous step was outside the surface.
            let crosses = going[i] & (value >= 1.0) & (below[i] < 0.0);
            let passes = going[i] & !crosses;
            met[i] |= crosses;
            low[i] = if passes { way[i] } else { low[i] };
            below[i] = if passes { value - 1.0 } else { below[i] };
            high[i] = if crosses { way[i] } else { high[i] };
            above[i] = if crosses { value - 1.0 } else { above[i] };
            going[i] = passes & (way[i] < span.leave[i]);
        }
        onward
    }
}

impl<const N: usize> Bracket<N> {
    /// Position at which the line between both ends crosses the surface.
    #[inline(always)]
    fn crossing(&self) -> [f32; N] {
        let Bracket { low, high, values: [below, above] } = self;
        std::array::from_fn(|i| {
            let way = (low[i] * above[i] - high[i] * below[i]) / max(above[i] - below[i], 1e-20);
            clamp(way, low[i], high[i])
        })
    }
}
