//! Surface of a clump: a smooth union of bumpy particles, intersected by ray marching.
//!
//! Each particle has a field vᵢ = α (1 − |p − cᵢ|²/Rᵢ²)₊ (1 + b nᵢ), Rᵢ = (1 + κ) rᵢ, that is 1 at
//! the radius without bumps nᵢ (|nᵢ| ≤ 1, they move with it). The surface is N = (Σ vᵢ²)^½ = 1, a
//! soft object (Wyvill, McPheeters, Wyvill, Visual Computer 2, 1986): its normal is smooth, and no
//! part of it is farther from a center than Rᵢ, whatever the bumps.

mod field;
mod march;
mod nearby;
mod rays;

use super::spheres::{Near, Sphere, Spheres};
use crate::simd::f32x64::*;
use crate::wall::packet::{MISS, Pyramid, farthest_of};
use crate::wall::visibility;
use field::REACH;
use nearby::Clump;
use rayon::prelude::*;
use rays::reached;
use std::ops::Range;

pub use field::{phases, wave};
pub use rays::{Beams, Met};

/// Number of rays that are marched together; more would wait for the slowest of them.
const ROW: usize = 8;

impl Spheres {
    /// Builds the hierarchy over particles; those of an instance with several share a surface.
    pub fn bound(mut all: Vec<Sphere>) -> Self {
        let mut count = vec![0u32; 1 << 16];
        for sphere in &all {
            count[usize::from(sphere.instance)] += 1;
        }
        for sphere in &mut all {
            let is_alone = count[usize::from(sphere.instance)] == 1;
            sphere.reach = if is_alone { 1.0 } else { REACH } * sphere.radius;
        }
        Self::build(all)
    }

    /// Ends the rays of a tile at particles, and returns their hits. With `ANY` only the existence
    /// of a hit is computed: such rays end at 0.
    ///
    /// `near` contains all particles within whose reach the rays may come.
    #[inline(always)]
    pub fn meet<const ANY: bool>(
        &self,
        near: &mut [Near],
        beams: &Beams<'_, LANES>,
        until: &mut Lane,
        met: &mut Met<LANES>,
    ) {
        if near.is_empty() {
            return;
        }
        let groups = self.clumps(near);
        for first in (0..LANES).step_by(ROW) {
            let pick = |lanes: &Lane| -> [f32; ROW] { std::array::from_fn(|i| lanes[first + i]) };
            let [starts, headings] =
                [beams.starts, beams.headings].map(|v| [0, 1, 2].map(|k| pick(&v[k])));
            let row = Beams { starts: &starts, headings: &headings, from: &pick(beams.from) };
            let (mut ends, mut theirs) = (pick(until), Met::nothing());
            for group in &groups {
                self.meet_clump::<ROW, ANY>(&near[group.clone()], &row, &mut ends, &mut theirs);
            }
            for i in 0..ROW {
                until[first + i] = ends[i];
                if theirs.owner[i] != MISS {
                    met.take(first + i, (&theirs, i));
                }
            }
        }
    }

    /// Runs `meet` for one ray.
    #[inline(always)]
    pub fn meet_ray<const ANY: bool>(
        &self,
        near: &mut [Near],
        (start, heading): (Vec3, Vec3),
        until: f32,
    ) -> (f32, Met<1>) {
        let (mut until, mut met) = ([until], Met::nothing());
        let (starts, headings) = (&start.map(|x| [x]), &heading.map(|x| [x]));
        let beams = Beams { starts, headings, from: &[0.0] };
        for group in self.clumps(near) {
            self.meet_clump::<1, ANY>(&near[group], &beams, &mut until, &mut met);
        }
        (until[0], met)
    }

    /// Sorts particles by clump; returns the ranges of the clumps, the nearest first.
    fn clumps(&self, near: &mut [Near]) -> Vec<Range<usize>> {
        let of = |near: &Near| self.all[near.index as usize].instance;
        // An order that does not depend on the hierarchy, because sums depend on it.
        near.sort_unstable_by_key(|near| (of(near), self.all[near.index as usize].number));
        let mut groups = Vec::new();
        let mut first = 0;
        for group in near.chunk_by(|a, b| of(a) == of(b)) {
            let nearest = group.iter().fold(f32::MAX, |least, near| min(least, near.power));
            groups.push((nearest, first..first + group.len()));
            first += group.len();
        }
        groups.sort_by(|a, b| a.0.total_cmp(&b.0));
        groups.into_iter().map(|(_, group)| group).collect()
    }

    /// Runs `meet` for some rays and the particles of one clump.
    #[inline(always)]
    fn meet_clump<const N: usize, const ANY: bool>(
        &self,
        group: &[Near],
        beams: &Beams<'_, N>,
        until: &mut [f32; N],
        met: &mut Met<N>,
    ) {
        let first = &self.all[group[0].index as usize];
        if first.is_alone() {
            meet_ball::<N, ANY>((first, group[0].index), beams, until, met);
            return;
        }
        let (clump, span) = Clump::gather(&self.all, group, beams, until);
        if clump.members.is_empty() {
            return;
        }
        let ways = clump.meet::<N, ANY>(beams, &span);
        let nearer = std::array::from_fn(|i| ways[i] < until[i]);
        if !nearer.contains(&true) {
            return;
        }
        let mut points = [[0.0; N]; 3];
        for i in 0..N {
            until[i] = if nearer[i] { if ANY { 0.0 } else { ways[i] } } else { until[i] };
            for k in 0..3 {
                points[k][i] = beams.starts[k][i] + until[i] * beams.headings[k][i];
            }
        }
        if !ANY {
            clump.look(&points, &nearer, met);
        }
    }

    /// `true` where the segment from `origin` to a point is unoccluded; false for points with NaN.
    pub fn free(&self, origin: Vec3, points: &[Vec3], extent: f32) -> Vec<bool> {
        let mut result = vec![false; points.len()];
        result.par_chunks_mut(LANES).zip(points.par_chunks(LANES)).for_each(|(out, chunk)| {
            let (mut lanes, mut free) = ([[0.0; LANES]; 3], [false; LANES]);
            for (i, point) in chunk.iter().enumerate() {
                free[i] = point.iter().all(|x| x.is_finite());
                for k in 0..3 {
                    lanes[k][i] = if free[i] { point[k] } else { origin[k] };
                }
            }
            self.shade(origin, &lanes, extent, &mut Vec::new(), &mut free);
            out.copy_from_slice(&free[..chunk.len()]);
        });
        result
    }

    /// Removes from `lit` the points that a sphere occludes from `origin`.
    #[inline(always)]
    pub fn shade(
        &self,
        origin: Vec3,
        points: &Lane3,
        extent: f32,
        near: &mut Vec<Near>,
        lit: &mut [bool; LANES],
    ) {
        let (directions, reach) = visibility::shadow_segments(origin, points, lit);
        let rays = Pyramid::around(directions, lit);
        self.gather(origin, &rays, extent, farthest_of(&reach), near);
        let starts = &origin.map(|x| [x; LANES]);
        let beams = Beams { starts, headings: &rays.directions, from: &[0.0; LANES] };
        let mut until = reach;
        self.meet::<true>(near, &beams, &mut until, &mut Met::nothing());
        for i in 0..LANES {
            lit[i] &= until[i] == reach[i];
        }
    }

    /// Surface properties at a point on a particle.
    pub fn look_at(&self, index: u32, point: Vec3) -> Met<1> {
        let (mut near, mut met) = (Vec::new(), Met::nothing());
        let own = &self.all[index as usize];
        if own.is_alone() {
            met.put_ball(0, own, index, point);
            return met;
        }
        self.within((point, point), point, &mut near);
        near.retain(|near| self.all[near.index as usize].instance == own.instance);
        near.sort_unstable_by_key(|near| self.all[near.index as usize].number);
        Clump::of(&self.all, &near).look(&point.map(|x| [x]), &[true], &mut met);
        met
    }
}

/// Runs `Spheres::meet` for some rays and a single particle: a sphere without bumps.
#[inline(always)]
fn meet_ball<const N: usize, const ANY: bool>(
    (sphere, index): (&Sphere, u32),
    beams: &Beams<'_, N>,
    until: &mut [f32; N],
    met: &mut Met<N>,
) {
    let [enter, _] = reached(sphere, beams);
    for i in 0..N {
        if (enter[i] > beams.from[i]) & (enter[i] < until[i]) {
            until[i] = if ANY { 0.0 } else { enter[i] };
            let way = scale(at(beams.headings, i), enter[i]);
            met.put_ball(i, sphere, index, add(at(beams.starts, i), way));
        }
    }
}
