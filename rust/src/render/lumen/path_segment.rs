//! Straight segments of a tile's rays, and the contents along them: bubbles and liquid.

use super::bubble::{Behind, Eye, Film};
use super::liquid::{Optics, Wet};
use super::refraction::Turn;
use crate::lumen::spheres::{Near, Spheres};
use crate::render::led::Led;
use crate::simd::f32x64::*;
use crate::wall::packet::{Hits, Pyramid};

/// Straight segments of rays; distances are measured along the whole path from the camera.
pub struct PathSegment<'a> {
    /// Directions, and the pyramid around them.
    pub rays: &'a Pyramid,
    /// Virtual start of each ray if its whole path were a straight extension of this segment [m].
    pub starts: &'a Lane3,
    /// Mean of the starts.
    pub origin: Vec3,
    /// Lanes that have such a segment.
    pub used: &'a [bool; LANES],
    /// Lanes whose segment lies in liquid.
    pub soaked: [bool; LANES],
    /// Start distance [m].
    pub from: &'a Lane,
    /// End distance [m].
    pub to: &'a Lane,
}

/// Bubbles along a segment, the farthest first, and their common properties.
pub struct Bubbles<'a> {
    /// All bubbles.
    pub spheres: &'a Spheres,
    /// Bubbles near the segment.
    pub near: &'a [Near],
    /// Their shells.
    pub film: &'a Film,
    /// Angle between pixels [rad].
    pub pixel_angle: f32,
}

impl PathSegment<'_> {
    /// Transports radiance from the end of the segment to its start.
    #[inline(always)]
    pub fn carry(
        &self,
        bubbles: &Bubbles<'_>,
        liquid: Option<(&Optics, &Wet)>,
        leds: &[Led],
        radiance: &mut Lane3,
    ) {
        let mut reached = *self.to;
        let liquid = liquid.filter(|_| self.soaked.contains(&true));
        let eye = Eye {
            origin: self.origin,
            starts: self.starts,
            rays: self.rays,
            pixel_angle: bubbles.pixel_angle,
        };
        for near in bubbles.near {
            let sphere = &bubbles.spheres.all[near.index as usize];
            let (start, directions) = (|i| at(self.starts, i), &self.rays.directions);
            let met = bubbles.spheres.bubble_crossings(near.index, bubbles.near, start, directions);
            let Some(mut crossings) = met else { continue };
            let mut covered = [false; LANES];
            for i in 0..LANES {
                let inside = |distance: f32| {
                    (distance > self.from[i]) & (distance < self.to[i]) & self.used[i]
                };
                crossings.near[i] =
                    if inside(crossings.near[i]) { crossings.near[i] } else { -1.0 };
                crossings.far[i] = if inside(crossings.far[i]) { crossings.far[i] } else { -1.0 };
                covered[i] = max(crossings.near[i], crossings.far[i]) > 0.0;
            }
            if !covered.contains(&true) {
                continue;
            }
            let mut dimmed = None;
            if let Some((optics, wet)) = liquid {
                self.soak(optics, wet, leds, (&covered, &crossings.far, &mut reached), radiance);
                let i = covered.iter().position(|&c| c).unwrap_or(0);
                dimmed = Some(optics.dimmed(leds, sphere.center, wet, i));
                for i in (0..LANES).filter(|&i| covered[i] & (crossings.near[i] > 0.0)) {
                    reached[i] = min(reached[i], crossings.near[i]);
                }
            }
            let mut behind = Behind { radiance, distance: self.to };
            let leds = dimmed.as_deref().unwrap_or(leds);
            bubbles.film.cover(sphere, &crossings, &eye, leds, &mut behind);
        }
        if let Some((optics, wet)) = liquid {
            self.soak(optics, wet, leds, (self.used, self.from, &mut reached), radiance);
        }
    }

    /// Transports the light of some lanes from the distance `reached` through the liquid to `goal`.
    #[inline(always)]
    fn soak(
        &self,
        optics: &Optics,
        wet: &Wet,
        leds: &[Led],
        (lanes, goal, reached): (&[bool; LANES], &Lane, &mut Lane),
        radiance: &mut Lane3,
    ) {
        let (mut length, mut starts) = ([0.0; LANES], *self.starts);
        for i in 0..LANES {
            let goal = max(goal[i], self.from[i]);
            let is_due = lanes[i] & self.soaked[i] & (goal < reached[i]);
            length[i] = if is_due { reached[i] - goal } else { 0.0 };
            reached[i] = if is_due { goal } else { reached[i] };
            for k in 0..3 {
                let distance = if is_due { goal } else { 0.0 };
                starts[k][i] += distance * self.rays.directions[k][i];
            }
        }
        optics.carry((&starts, &self.rays.directions, &length), leds, wet, radiance);
    }
}

/// Ends of the straight paths from the camera [m].
#[inline(always)]
pub fn first_segment(wet: Option<&Wet>, hits: &Hits) -> Lane {
    let Some(wet) = wet else { return hits.distance };
    std::array::from_fn(|i| min(wet.turn.distance[i], hits.distance[i]))
}

/// Virtual starts of rays that continue along `heading` after a turn, as if their whole path were
/// straight; the mean of these points, and the bounding box of the paths to their `ends`.
#[inline(always)]
pub fn unfolded(
    turn: &Turn,
    heading: &Lane3,
    ends: &Lane3,
    lanes: &[bool; LANES],
) -> (Lane3, Vec3, Corners) {
    let (mut around, mut sum, mut count) = (EMPTY_BOX, [0.0; 3], 0.0);
    let mut starts = turn.place;
    for i in (0..LANES).filter(|&i| lanes[i]) {
        for k in 0..3 {
            starts[k][i] -= turn.distance[i] * heading[k][i];
            sum[k] += starts[k][i];
        }
        enclose(&mut around, at(&turn.place, i));
        enclose(&mut around, at(ends, i));
        count += 1.0;
    }
    (starts, scale(sum, 1.0 / max(count, 1.0)), around)
}
