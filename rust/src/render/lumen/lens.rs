//! Refraction of camera rays in bubbles that lie in liquid: diverging lenses in front of the wall.

use super::bubble::Film;
use super::refraction::{REFRACTED, STRAIGHT, Turn};
use crate::lumen::spheres::{Near, Sphere, Spheres};
use crate::render::material::refract_into;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{MISS, Pyramid};
use crate::wall::ray;

impl Film {
    /// Turns of rays in the first bubble on each of them, by Snell's law at both of its surfaces;
    /// none if no ray is refracted.
    ///
    /// A ray ends at the wall or at the distance `until`. Its turn is at the point where it leaves
    /// the bubble, or where it enters one that encloses the point of the wall that it shows. `near`
    /// contains all bubbles that the rays may hit; common walls have no effect.
    pub fn refract(
        &self,
        (spheres, near): (&Spheres, &[Near]),
        wall: &Wall,
        (origin, rays): (Vec3, &Pyramid),
        until: &Lane,
    ) -> Option<Turn> {
        let mut first = *until;
        let (mut nearest, mut misses) = ([MISS; LANES], [0.0; LANES]);
        for &Near { index, .. } in near {
            let sphere = &spheres.all[index as usize];
            let [enter, _, miss] = sphere.ends(&|_| origin, &rays.directions);
            for i in 0..LANES {
                let nearer = (enter[i] > 0.0) & (enter[i] < first[i]);
                first[i] = if nearer { enter[i] } else { first[i] };
                nearest[i] = if nearer { index } else { nearest[i] };
                misses[i] = if nearer { miss[i] } else { misses[i] };
            }
        }
        let mut turn = Turn::none();
        for i in (0..LANES).filter(|&i| nearest[i] != MISS) {
            let sphere = &spheres.all[nearest[i] as usize];
            self.turn(&mut turn, i, (sphere, misses[i]), wall, (origin, rays, first[i]));
        }
        turn.kind.iter().any(|&kind| kind != STRAIGHT).then_some(turn)
    }

    /// Turns lane `i` in a sphere that it enters at the distance `enter`, unless it is totally
    /// reflected there.
    #[inline(always)]
    fn turn(
        &self,
        turn: &mut Turn,
        i: usize,
        (sphere, miss): (&Sphere, f32),
        wall: &Wall,
        (origin, rays, enter): (Vec3, &Pyramid, f32),
    ) {
        let (index, heading) = (self.lens_index(sphere), at(&rays.directions, i));
        let square = 1.0 - index * index * miss;
        if square <= 0.0 {
            return;
        }
        let inward = |place: Vec3| scale(sub(sphere.center, place), 1.0 / sphere.radius);
        let start = add(origin, scale(heading, enter));
        let inside = refract_into(scale(heading, -1.0), scale(inward(start), -1.0), 1.0 / index);
        let chord = 2.0 * square.sqrt() * sphere.radius;
        turn.kind[i] = REFRACTED;
        let ends = ray::cast::<true>(&wall.bvh, start, inside, chord, MISS).is_some();
        let (distance, place, heading) = if ends {
            (enter, start, inside)
        } else {
            let place = add(start, scale(inside, chord));
            (enter + chord, place, refract_into(scale(inside, -1.0), inward(place), index))
        };
        turn.distance[i] = distance;
        for k in 0..3 {
            turn.place[k][i] = place[k];
            turn.heading[k][i] = heading[k];
        }
    }

    /// Refractive index of the liquid around a bubble relative to that within, for which rays are
    /// totally reflected where its rim is: 1 for one that has emerged.
    #[inline(always)]
    fn lens_index(&self, sphere: &Sphere) -> f32 {
        1.0 / (1.0 - self.border * self.sunk(sphere))
    }
}
