//! The wall of one world: where it is driven, how far it gives way, what of it is near.

use super::body::{Axis, Body, Motion};
use super::contact::Facet;
use super::lane::{LANES, Lane3, at, put};
use super::near::{Near, point};
use super::patch::Patch;
use super::quick::{Push, Quick, Yield, attenuate};
use crate::wall::Wall;
use glam::DVec3;
use rayon::prelude::*;

/// How far capsule and wall may move before what is near is searched anew [m].
pub const MARGIN: f64 = 1e-3;

/// Rounding in what is known of distances [m].
const CLOSE: f64 = 1e-9;

/// What went wrong, in words for the user.
pub type Outcome = Result<(), &'static str>;

/// How the lumen narrows and widens: vertices go towards the centreline.
pub struct Drive {
    /// Vertices at rest [m], about the wall's centre.
    pub rest: Vec<DVec3>,
    /// From each vertex to the centreline [m].
    pub inward: Vec<DVec3>,
    /// Place of each vertex along the calibre's samples, 0 to one less than their number.
    pub station: Vec<f64>,
}

impl Drive {
    /// Where a vertex is for calibres given as factors of the lumen's radius at rest.
    #[inline(always)]
    pub fn place(&self, v: usize, calibre: &[f64]) -> DVec3 {
        let last = calibre.len() - 1;
        let station = self.station[v].clamp(0.0, last as f64);
        let first = (station as usize).min(last.saturating_sub(1));
        let share = station - first as f64;
        let factor = calibre[first] + share * (calibre[(first + 1).min(last)] - calibre[first]);
        self.rest[v] + self.inward[v] * (1.0 - factor)
    }
}

/// The wall's part of the state, and what is kept between substeps.
pub struct SoftWall {
    /// Where the wall would be if nothing touched it [m], about its centre.
    pub driven: Vec<DVec3>,
    /// Where it would be at the end of the step [m]; empty when it rests.
    pub target: Vec<DVec3>,
    /// How that moves during the step [m/s]; empty when it rests.
    pub driven_velocity: Vec<DVec3>,
    /// Largest speed of these [m/s].
    pub driven_speed: f64,
    /// How far each vertex gives way.
    pub yields: Vec<Yield>,
    /// Vertices that may give way or are not back yet, by rising number.
    pub awake: Vec<u32>,
    pub near: Near,
    /// How far capsule and wall must have travelled before each near triangle can touch [m].
    clear: Vec<f64>,
    pub facets: Vec<Facet>,
    pub patch: Patch,
    pub pushes: Vec<Push>,
    /// Places of awake vertices [m] and the forces on them [N]; kept to be overwritten.
    places: Vec<Lane3>,
    forces: Vec<Lane3>,
    /// Time since the step began [s].
    pub since: f64,
    /// How far capsule and wall may have come towards each other since the last search [m].
    pub travel: f64,
    /// How far the wall may be from its hierarchy [m].
    pub wall_travel: f64,
}

impl SoftWall {
    pub fn new(wall: &Wall) -> Self {
        SoftWall {
            driven: (0..wall.vertices.len() as u32).map(|v| point(wall, v)).collect(),
            target: Vec::new(),
            driven_velocity: Vec::new(),
            driven_speed: 0.0,
            yields: vec![Yield::default(); wall.vertices.len()],
            awake: Vec::new(),
            near: Near::default(),
            clear: Vec::new(),
            facets: Vec::new(),
            patch: Patch::default(),
            pushes: Vec::new(),
            places: Vec::new(),
            forces: Vec::new(),
            since: 0.0,
            travel: f64::INFINITY,
            wall_travel: 0.0,
        }
    }

    /// Position and velocity of a vertex now.
    #[inline(always)]
    pub fn vertex(&self, v: u32) -> (DVec3, DVec3) {
        let (v, yielded) = (v as usize, &self.yields[v as usize]);
        let place = self.driven[v] + yielded.displacement;
        match self.driven_velocity.get(v) {
            Some(&velocity) => (place + self.since * velocity, velocity + yielded.velocity),
            None => (place, yielded.velocity),
        }
    }

    /// Writes all vertices into the wall and refits its hierarchy.
    pub fn settle(&mut self, wall: &mut Wall) -> Outcome {
        if self.wall_travel > 0.0 {
            wall.move_to(|v| self.vertex(v as u32).0.to_array().map(|x| x as f32))?;
            self.wall_travel = 0.0;
        }
        Ok(())
    }

    /// Sets the driven wall on its way to a calibre at the end of a step of `duration` [s].
    pub fn aim(&mut self, drive: &Drive, calibre: &[f64], duration: f64) {
        let ways = self.driven.par_iter().with_min_len(4096).enumerate().map(|(v, &from)| {
            let to = drive.place(v, calibre);
            (to, (to - from) / duration)
        });
        ways.unzip_into_vecs(&mut self.target, &mut self.driven_velocity);
        let squares = self.driven_velocity.par_iter().with_min_len(4096);
        let fastest = squares.map(|v| v.length_squared()).reduce(|| 0.0, f64::max);
        self.driven_speed = fastest.sqrt();
    }

    /// Ends a step: the driven wall has arrived.
    pub fn land(&mut self) {
        if !self.target.is_empty() {
            std::mem::swap(&mut self.driven, &mut self.target);
        }
        self.stay();
    }

    /// Gives up a step: the driven wall stays where it was.
    pub fn stay(&mut self) {
        self.target.clear();
        self.driven_velocity.clear();
        (self.driven_speed, self.since) = (0.0, 0.0);
    }

    pub fn awake_yields(&self) -> Vec<(u32, Yield)> {
        self.awake.iter().map(|&v| (v, self.yields[v as usize])).collect()
    }

    pub fn restore_yields(&mut self, before: Vec<(u32, Yield)>) {
        self.awake.iter().for_each(|&v| self.yields[v as usize] = Yield::default());
        for &(v, value) in &before {
            self.yields[v as usize] = value;
        }
        self.awake = before.into_iter().map(|(v, _)| v).collect();
        (self.travel, self.wall_travel) = (f64::INFINITY, f64::INFINITY);
    }

    /// Triangles that may touch the capsule, as they are now; those too far to have come close
    /// since they were last looked at are left out.
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

    /// One substep of the quick model.
    pub fn give_way(&mut self, quick: &Quick, dt: f64) {
        let mut places = std::mem::take(&mut self.places);
        places.clear();
        for eight in self.awake.chunks(LANES) {
            let mut place = [[0.0; LANES]; 3];
            for (i, &v) in eight.iter().enumerate() {
                put(&mut place, i, self.vertex(v).0);
            }
            places.push(place);
        }
        attenuate(quick, &places, &self.pushes, &mut self.forces);
        self.places = places;
        let mut fastest = 0.0f64;
        for (k, &v) in self.awake.iter().enumerate() {
            let force = at(&self.forces[k / LANES], k % LANES);
            let vertex = &mut self.yields[v as usize];
            if force == DVec3::ZERO && vertex.is_still() {
                *vertex = Yield::default();
                continue;
            }
            quick.advance(vertex, force, dt);
            fastest = fastest.max(vertex.velocity.length_squared());
        }
        let moved = fastest.sqrt() * dt;
        self.travel += moved;
        self.wall_travel += moved;
    }

    /// Looks for what is near the capsule; refits the wall first where it has moved too far.
    pub fn search(&mut self, wall: &mut Wall, body: &Body, motion: &Motion, reach: f64) -> Outcome {
        if self.wall_travel > MARGIN {
            self.settle(wall)?;
        }
        let radius = body.radius + 2.0 * MARGIN;
        self.near.find(wall, &body.axis(motion), radius, radius + reach);
        self.travel = 0.0;
        self.clear.clear();
        self.clear.resize(self.near.corners.len(), 0.0);
        self.awake.retain(|&v| self.yields[v as usize] != Yield::default());
        if reach > 0.0 {
            self.awake.extend(&self.near.around);
            self.awake.sort_unstable();
            self.awake.dedup();
        }
        Ok(())
    }
}
