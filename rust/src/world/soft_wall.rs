//! Wall of one world: prescribed motion, displacement by contact, and the part near the capsule.

use super::body::{Axis, Body, Motion};
use super::broad_phase::{Bounds, NearbyWall, point};
use super::contact::Facet;
use super::contact_patch::Patch;
use super::series::Series;
use crate::simd::f64x8::{LANES, Lane3, at, min, put};
use crate::tissue::spring_wall::{ContactForce, SpringWall, VertexMotion, attenuate};
use crate::wall::Wall;
use glam::DVec3;
use rayon::prelude::*;

/// Travel of capsule and wall after which near triangles are searched again [m].
pub const MARGIN: f64 = 1e-3;

/// Travel of contact forces after which the vertices that they move are searched again [m].
const AWAKE_MARGIN: f64 = 2e-3;

/// Rounding error of distances [m].
const CLOSE: f64 = 1e-9;

/// Result with an error message for the user.
pub type Outcome = Result<(), &'static str>;

/// Radial motion of the lumen: vertices move towards the centerline.
pub struct Drive {
    /// Vertices at rest [m], relative to the wall's center.
    rest: Vec<DVec3>,
    /// Vector from each vertex to the centerline [m].
    inward: Vec<DVec3>,
    /// Index of each vertex along the samples of `lumen_scale`, 0 or more.
    sample: Vec<f64>,
    /// Maximum distance to the centerline between two samples [m].
    longest: Vec<f64>,
}

/// Prescribed motion of the wall in a step.
struct Way {
    /// Lumen radius at the end of the step at each sample, as a factor of that at rest.
    lumen_scale: Vec<f64>,
    /// Rate of decrease of the factor [1/s].
    shrinking: Vec<f64>,
}

impl Drive {
    pub fn new(rest: Vec<DVec3>, inward: Vec<DVec3>, sample: &[f64]) -> Self {
        let sample: Vec<f64> = sample.iter().map(|s| s.max(0.0)).collect();
        let mut longest = Vec::new();
        for (way, sample) in inward.iter().zip(&sample) {
            let sample = *sample as usize;
            longest.resize(longest.len().max(sample + 1), 0.0);
            longest[sample] = f64::max(longest[sample], way.length());
        }
        Drive { rest, inward, sample, longest }
    }

    /// Value at a vertex, interpolated from values at the samples.
    #[inline(always)]
    fn share(&self, v: usize, samples: &[f64]) -> f64 {
        let last = samples.len() - 1;
        let sample = min(self.sample[v], last as f64);
        let first = sample as usize;
        let (here, next) = (samples[first], samples[(first + 1).min(last)]);
        here + (sample - first as f64) * (next - here)
    }

    /// Position of a vertex for a `lumen_scale`, given as factors of the lumen's radius at rest.
    #[inline(always)]
    fn place(&self, v: usize, lumen_scale: &[f64]) -> DVec3 {
        self.rest[v] + self.inward[v] * (1.0 - self.share(v, lumen_scale))
    }

    /// Upper bound of the vertices' speed [m/s].
    fn fastest(&self, shrinking: &[f64]) -> f64 {
        let last = shrinking.len() - 1;
        let larger =
            |k: usize| shrinking[k.min(last)].abs().max(shrinking[(k + 1).min(last)].abs());
        let speeds = self.longest.iter().enumerate().map(|(k, longest)| longest * larger(k));
        speeds.fold(0.0, f64::max)
    }
}

/// Region in which contact forces move only awake vertices.
struct Awoken {
    /// Bounding box of the contact forces at the search.
    bounds: Bounds,
    /// Permitted distance of contact forces from the box [m].
    margin: f64,
}

/// State of the wall, and data kept between substeps.
pub struct SoftWall {
    /// Positions of the vertices without contact [m], relative to the wall's center.
    pub active_wall: Vec<DVec3>,
    /// Prescribed motions that the wall supports.
    pub drive: Option<Drive>,
    /// Prescribed motion of this step; `None` at rest.
    way: Option<Way>,
    /// Upper bound of the speed of the prescribed motion [m/s].
    pub active_speed: f64,
    /// Displacement of each vertex by contact.
    pub wall_displacement: Vec<VertexMotion>,
    /// Vertices that may be displaced by contact, ascending.
    pub awake: Vec<u32>,
    /// Region of the awake vertices; `None` if they must be searched.
    awoken: Option<Awoken>,
    /// True if only awake vertices are displaced.
    is_spring_wall: bool,
    /// Vertices that were displaced at the last refit of the hierarchy.
    stirred: Vec<u32>,
    /// True if other vertices may have moved since that refit.
    was_driven: bool,
    pub near: NearbyWall,
    /// Travel of capsule and wall before which each near triangle cannot be in contact [m].
    pub clear: Vec<f64>,
    pub facets: Vec<Facet>,
    pub patch: Patch,
    pub contact_forces: Vec<ContactForce>,
    /// Positions of awake vertices [m] and the forces on them [N]; reused buffers.
    pub places: Vec<Lane3>,
    pub forces: Vec<Lane3>,
    /// Data of quasi-static motion.
    pub series: Series,
    /// Time since the start of the step [s].
    pub since: f64,
    /// Upper bound of the approach of capsule and wall since the last search [m].
    pub travel: f64,
    /// Upper bound of the distance of the wall from its hierarchy [m].
    pub wall_travel: f64,
}

impl SoftWall {
    pub fn new(wall: &Wall, is_spring_wall: bool) -> Self {
        SoftWall {
            active_wall: (0..wall.vertices.len() as u32).map(|v| point(wall, v)).collect(),
            drive: None,
            way: None,
            active_speed: 0.0,
            wall_displacement: vec![VertexMotion::default(); wall.vertices.len()],
            awake: Vec::new(),
            awoken: None,
            is_spring_wall,
            stirred: Vec::new(),
            was_driven: false,
            near: NearbyWall::default(),
            clear: Vec::new(),
            facets: Vec::new(),
            patch: Patch::default(),
            contact_forces: Vec::new(),
            places: Vec::new(),
            forces: Vec::new(),
            series: Series::default(),
            since: 0.0,
            travel: f64::INFINITY,
            wall_travel: 0.0,
        }
    }

    /// Current position and velocity of a vertex.
    #[inline(always)]
    pub fn vertex(&self, v: u32) -> (DVec3, DVec3) {
        let yielded = &self.wall_displacement[v as usize];
        let (place, velocity) = self.driven_vertex(v as usize);
        (place + yielded.displacement, velocity + yielded.velocity)
    }

    /// Current position and velocity of a vertex without contact.
    #[inline(always)]
    fn driven_vertex(&self, v: usize) -> (DVec3, DVec3) {
        let place = self.active_wall[v];
        let Some((drive, way)) = self.drive.as_ref().zip(self.way.as_ref()) else {
            return (place, DVec3::ZERO);
        };
        let velocity = drive.inward[v] * drive.share(v, &way.shrinking);
        (place + self.since * velocity, velocity)
    }

    /// Writes moved vertices into the wall and refits its hierarchy.
    pub fn settle(&mut self, wall: &mut Wall) -> Outcome {
        if self.wall_travel > 0.0 {
            let seen = |place: DVec3| place.to_array().map(|x| x as f32);
            if self.is_spring_wall {
                let is_driven = self.was_driven || self.way.is_some();
                let gives =
                    |v: &&u32| self.wall_displacement[**v as usize].displacement != DVec3::ZERO;
                let giving: Vec<u32> = self.awake.iter().filter(gives).copied().collect();
                let stirred = if is_driven { &[] } else { &self.stirred[..] };
                let moved = giving.iter().chain(stirred);
                let moved: Vec<_> = moved.map(|&v| (v, seen(self.vertex(v).0))).collect();
                if is_driven {
                    wall.follow(|v| seen(self.driven_vertex(v).0), &moved)?;
                } else {
                    wall.follow_some(&moved)?;
                }
                self.stirred = giving;
                self.was_driven = self.way.is_some();
            } else {
                wall.follow(|v| seen(self.vertex(v as u32).0), &[])?;
            }
            self.wall_travel = 0.0;
        }
        Ok(())
    }

    /// Sets the prescribed motion from one `lumen_scale` to another in a step of `duration` [s].
    pub fn aim(&mut self, from: &[f64], to: &[f64], duration: f64) {
        let shrinking: Vec<f64> = from.iter().zip(to).map(|(a, b)| (a - b) / duration).collect();
        self.active_speed = self.drive.as_ref().map_or(0.0, |drive| drive.fastest(&shrinking));
        self.way = Some(Way { lumen_scale: to.to_vec(), shrinking });
    }

    /// Ends a step: moves the wall to the end of its prescribed motion.
    pub fn land(&mut self) {
        if let Some((drive, way)) = self.drive.as_ref().zip(self.way.as_ref()) {
            let places = self.active_wall.par_iter_mut().with_min_len(4096).enumerate();
            places.for_each(|(v, place)| *place = drive.place(v, &way.lumen_scale));
            self.was_driven = true;
        }
        self.stay();
    }

    /// Replaces the positions without contact.
    pub fn set_active_wall(&mut self, active_wall: Vec<DVec3>) {
        self.was_driven |= active_wall != self.active_wall;
        self.active_wall = active_wall;
        self.forget_near();
    }

    /// Requires a new search for near triangles.
    pub fn forget_near(&mut self) {
        self.awoken = None;
        (self.travel, self.wall_travel) = (f64::INFINITY, f64::INFINITY);
    }

    /// Cancels a step: the wall keeps its positions without contact.
    pub fn stay(&mut self) {
        self.way = None;
        (self.active_speed, self.since) = (0.0, 0.0);
    }

    pub fn awake_displacements(&self) -> Vec<(u32, VertexMotion)> {
        self.awake.iter().map(|&v| (v, self.wall_displacement[v as usize])).collect()
    }

    pub fn restore_displacements(&mut self, before: Vec<(u32, VertexMotion)>) {
        self.awake
            .iter()
            .for_each(|&v| self.wall_displacement[v as usize] = VertexMotion::default());
        for &(v, value) in &before {
            self.wall_displacement[v as usize] = value;
        }
        self.awake = before.into_iter().map(|(v, _)| v).collect();
        self.forget_near();
    }

    /// Updates the triangles that may be in contact with the capsule; skips those too far away to
    /// have approached since their last update.
    pub fn update_facets(&mut self, axis: &Axis, radius: f64) {
        self.facets.clear();
        for (place, corners) in self.near.corners.iter().enumerate() {
            if self.travel < self.clear[place] {
                continue;
            }
            let moving = corners.map(|k| self.vertex(self.near.vertices[k as usize]));
            let facet = Facet::new(place as u32, moving, axis);
            let gap = facet.distance - facet.reach - radius;
            self.clear[place] = self.travel + gap - CLOSE;
            if gap < 0.0 {
                self.facets.push(facet);
            }
        }
    }

    /// Records that a time [s] has passed, in which the capsule moved by a distance [m].
    pub fn pass(&mut self, time: f64, way: f64) {
        let drive = self.active_speed * time;
        self.since += time;
        self.wall_travel += drive;
        self.travel += drive + way;
        if let Some(awoken) = &mut self.awoken {
            awoken.margin -= drive;
        }
    }

    /// Wakes the vertices that `contact_forces` may move.
    pub fn awaken(&mut self, wall: &Wall, spring_wall: &SpringWall) {
        let are_awake =
            self.awoken.as_ref().is_some_and(|awoken| awoken.holds(&self.contact_forces));
        if are_awake || self.contact_forces.is_empty() {
            return;
        }
        let bounds = Bounds::about(self.contact_forces.iter().map(|push| push.center));
        let reach = spring_wall.reach + AWAKE_MARGIN + self.wall_travel;
        self.awake.retain(|&v| self.wall_displacement[v as usize] != VertexMotion::default());
        self.near.add_vertices(wall, &bounds, reach, &mut self.awake);
        self.awake.sort_unstable();
        self.awake.dedup();
        self.awoken = Some(Awoken { bounds, margin: AWAKE_MARGIN });
    }

    /// Computes the forces of `contact_forces` on the awake vertices.
    fn push(&mut self, spring_wall: &SpringWall) {
        let mut places = std::mem::take(&mut self.places);
        places.clear();
        for eight in self.awake.chunks(LANES) {
            let mut place = [[0.0; LANES]; 3];
            for (i, &v) in eight.iter().enumerate() {
                put(&mut place, i, self.vertex(v).0);
            }
            places.push(place);
        }
        attenuate(spring_wall, &places, &self.contact_forces, &mut self.forces);
        self.places = places;
    }

    /// Advances the spring wall by one substep.
    pub fn give_way(&mut self, wall: &Wall, spring_wall: &SpringWall, dt: f64) {
        self.awaken(wall, spring_wall);
        self.move_awake(spring_wall, dt, |vertex, force| {
            spring_wall.advance(vertex, force, dt);
            vertex.velocity
        });
    }

    /// Moves the awake vertices by `contact_forces`; `advance` moves one and returns its
    /// displacement, in units of `scale` [m].
    pub fn move_awake(
        &mut self,
        spring_wall: &SpringWall,
        scale: f64,
        advance: impl Fn(&mut VertexMotion, DVec3) -> DVec3,
    ) {
        self.push(spring_wall);
        let mut farthest = 0.0f64;
        for (k, &v) in self.awake.iter().enumerate() {
            let force = at(&self.forces[k / LANES], k % LANES);
            let vertex = &mut self.wall_displacement[v as usize];
            if force == DVec3::ZERO && vertex.is_still() {
                *vertex = VertexMotion::default();
                continue;
            }
            farthest = farthest.max(advance(vertex, force).length_squared());
        }
        let moved = scale * farthest.sqrt();
        self.travel += moved;
        self.wall_travel += moved;
    }

    /// Searches the triangles near the capsule; refits the wall first if it has moved too far.
    pub fn search(&mut self, wall: &mut Wall, body: &Body, motion: &Motion) -> Outcome {
        if self.wall_travel > MARGIN {
            self.settle(wall)?;
        }
        self.near.find(wall, &body.axis(motion), body.radius + 2.0 * MARGIN);
        self.travel = 0.0;
        self.clear.clear();
        self.clear.resize(self.near.corners.len(), 0.0);
        Ok(())
    }
}

impl Awoken {
    /// True if contact forces move only awake vertices.
    fn holds(&self, pushes: &[ContactForce]) -> bool {
        let square = self.margin * self.margin;
        let is_near = |push: &ContactForce| self.bounds.square_distance(push.center) <= square;
        self.margin >= 0.0 && pushes.iter().all(is_near)
    }
}
