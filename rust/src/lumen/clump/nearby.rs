//! The particles of one clump near some rays.

use super::field::Field;
use super::rays::{Beams, Met, reached};
use crate::lumen::spheres::{Near, Sphere};
use crate::simd::f32x64::*;

/// A particle within whose reach some rays come, and their distances there [m].
pub struct Member {
    field: Field,
    sphere: Sphere,
    /// Index in `Spheres::all`.
    index: u32,
    enter: f32,
    leave: f32,
}

/// The particles of one clump near some rays.
pub struct Clump {
    /// In the order of their indices.
    pub members: Vec<Member>,
}

/// Distances at which rays are within reach of a clump [m].
pub struct Span<const N: usize> {
    /// First distance.
    pub enter: [f32; N],
    /// Last distance.
    pub leave: [f32; N],
    /// Smallest reach of the particles near a ray.
    pub finest: [f32; N],
}

impl Clump {
    /// Collects particles regardless of the rays.
    pub fn of(all: &[Sphere], near: &[Near]) -> Self {
        let member = |&Near { index, .. }: &Near| {
            let sphere = all[index as usize];
            Member { field: Field::of(&sphere), sphere, index, enter: 0.0, leave: f32::MAX }
        };
        Clump { members: near.iter().map(member).collect() }
    }

    /// Collects particles within reach of rays, and the distances at which rays are in reach.
    #[inline(always)]
    pub fn gather<const N: usize>(
        all: &[Sphere],
        near: &[Near],
        beams: &Beams<'_, N>,
        until: &[f32; N],
    ) -> (Self, Span<N>) {
        let mut span = Span { enter: [f32::MAX; N], leave: [0.0; N], finest: [f32::MAX; N] };
        let mut members = Vec::new();
        for &Near { index, .. } in near {
            let sphere = all[index as usize];
            let (mut first, mut last) = (f32::MAX, 0.0);
            let crossings = reached(&sphere, beams);
            for i in 0..N {
                let [enter, leave] = [max(crossings[0][i], beams.from[i]), crossings[1][i]];
                let touches = (leave > enter) & (enter < until[i]);
                span.enter[i] = if touches { min(span.enter[i], enter) } else { span.enter[i] };
                span.leave[i] = if touches { max(span.leave[i], leave) } else { span.leave[i] };
                let finest = min(span.finest[i], sphere.reach);
                span.finest[i] = if touches { finest } else { span.finest[i] };
                first = if touches { min(first, enter) } else { first };
                last = if touches { max(last, leave) } else { last };
            }
            if first < last {
                let field = Field::of(&sphere);
                members.push(Member { field, sphere, index, enter: first, leave: last });
            }
        }
        for i in 0..N {
            span.leave[i] = min(span.leave[i], until[i]);
        }
        (Clump { members }, span)
    }

    /// Σ vᵢ² and Σ vᵢ/Rᵢ [1/m] at a distance along each ray; inactive rays may have wrong values.
    #[inline(always)]
    pub fn field<const N: usize>(
        &self,
        beams: &Beams<'_, N>,
        way: &[f32; N],
        counts: &[bool; N],
    ) -> ([f32; N], [f32; N]) {
        let (mut low, mut high, mut points) = (f32::MAX, 0.0, [[0.0; N]; 3]);
        for i in 0..N {
            low = if counts[i] { min(low, way[i]) } else { low };
            high = if counts[i] { max(high, way[i]) } else { high };
            for k in 0..3 {
                points[k][i] = beams.starts[k][i] + way[i] * beams.headings[k][i];
            }
        }
        let (mut squares, mut slopes) = ([0.0; N], [0.0; N]);
        for Member { field, enter, leave, .. } in &self.members {
            if *enter > high || *leave < low {
                continue;
            }
            for i in 0..N {
                let value = field.at(at(&points, i));
                squares[i] += value * value;
                slopes[i] += value * field.inverse;
            }
        }
        (squares, slopes)
    }

    /// Distance at which each ray next comes within reach beyond `way` [m]; infinity if never.
    #[inline(always)]
    pub fn next<const N: usize>(&self, beams: &Beams<'_, N>, way: &[f32; N]) -> [f32; N] {
        let mut next = [f32::INFINITY; N];
        for Member { sphere, .. } in &self.members {
            let [enter, leave] = reached(sphere, beams);
            for i in 0..N {
                let comes = leave[i] > max(way[i], enter[i]);
                next[i] = if comes { min(next[i], enter[i]) } else { next[i] };
            }
        }
        next
    }

    /// Surface properties at points, in some lanes.
    #[inline(always)]
    pub fn look<const N: usize>(
        &self,
        points: &[[f32; N]; 3],
        lanes: &[bool; N],
        met: &mut Met<N>,
    ) {
        let (mut total, mut most) = ([0.0; N], [0.0; N]);
        let (mut normal, mut color) = ([[0.0; N]; 3], [[0.0; N]; 3]);
        for Member { field, sphere, index, .. } in &self.members {
            for i in 0..N {
                let (value, gradient) = field.gradient(at(points, i));
                let share = value * value;
                total[i] += share;
                met.owner[i] = if lanes[i] & (share > most[i]) { *index } else { met.owner[i] };
                most[i] = max(most[i], share);
                for k in 0..3 {
                    normal[k][i] -= value * gradient[k];
                    color[k][i] += share * sphere.color[k];
                }
            }
        }
        for i in (0..N).filter(|&i| lanes[i] & (total[i] > 0.0)) {
            let outwards = normalize(at(&normal, i));
            for k in 0..3 {
                met.normal[k][i] = outwards[k];
                met.color[k][i] = color[k][i] / total[i];
            }
        }
    }
}
