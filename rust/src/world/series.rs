//! Pieces of the foundation in series with the springs under them, over one part of quasi-static
//! motion.
//!
//! In a part of length h the springs yield to a force F by `C (F − k x)`, `C = h / (m μ + h k)`:
//! their own update without inertia, by backward Euler. If the force on the triangle's vertices is
//! ρ times its load P, and the load of its pieces grows by K with depth and c with speed, P changes
//! with the capsule's twist by 1 / (1 + (K + c/h) C ρ) of the change on a rigid base. Capsule and
//! wall are thus solved together, without oscillation between them.

use super::contact_patch::{FacetLoad, Samples};
use super::soft_wall::{MARGIN, SoftWall};
use super::substep::Sums;
use crate::simd::f64x8::{LANES, Lane, at, max, put, sum};
use crate::tissue::spring_wall::{SpringWall, attenuate};
use crate::wall::Wall;
use glam::DVec3;

/// Response of the loads of eight pieces of the wall to a change of the capsule's twist.
#[derive(Clone, Copy, Default)]
struct Answer {
    /// Load at the twist of the last part [N].
    base: Lane,
    /// Derivative by the speed of indentation [N·s/m].
    slope: Lane,
}

/// Triangle in contact in series with the springs under it.
#[derive(Clone, Copy, Default)]
struct Softness {
    /// Derivatives of its load by depth [N/m] and speed [N·s/m].
    stiffness: f64,
    damping: f64,
    /// Remaining fraction of the load's response.
    share: f64,
    /// Decrease of the springs' speed under the current loads [m/s].
    lead: f64,
}

/// Buffers that are reused.
#[derive(Default)]
pub struct Series {
    answers: Vec<Answer>,
    soft: Vec<Softness>,
    /// Index among the triangles in contact of each near triangle.
    numbers: Vec<u32>,
}

/// Force and torque of the wall against the capsule's normals, and their derivatives by its twist.
pub struct WallForce {
    pub force: [f64; 6],
    pub slope: [[f64; 6]; 6],
}

impl Answer {
    /// Load of a piece after a change of twist, never below 0 [N].
    #[inline(always)]
    fn load(&self, s: &Samples, i: usize, change: &[f64; 6]) -> f64 {
        let mut speed = 0.0;
        for row in 0..6 {
            speed += s.lever[row][i] * change[row];
        }
        max(self.base[i] + self.slope[i] * speed, 0.0)
    }
}

impl SoftWall {
    /// Computes the response of the pieces in contact in a part of `h` [s].
    pub fn find_answers(&mut self, spring_wall: Option<&SpringWall>, h: f64) {
        self.number_facets();
        self.soften(spring_wall, h);
        let Series { answers, soft, numbers } = &mut self.series;
        answers.clear();
        for (places, s) in self.patch.lanes() {
            let mut answer = Answer::default();
            for i in 0..LANES {
                if s.load[i] > 0.0 {
                    let of = &soft[numbers[places[i] as usize] as usize];
                    let slope = h * s.stiffness[i] + s.damping[i];
                    let more = h * s.stiffness[i] * s.speed[i] + slope * of.lead;
                    answer.base[i] = s.load[i] + of.share * more;
                    answer.slope[i] = of.share * slope;
                }
            }
            answers.push(answer);
        }
    }

    /// Numbers the triangles in contact and sums the slopes of their pieces.
    fn number_facets(&mut self) {
        let Series { soft, numbers, .. } = &mut self.series;
        numbers.clear();
        numbers.resize(self.near.corners.len(), 0);
        for (number, on_facet) in self.patch.facet_loads.iter().enumerate() {
            numbers[on_facet.place as usize] = number as u32;
        }
        soft.clear();
        soft.resize(self.patch.facet_loads.len(), Softness { share: 1.0, ..Softness::default() });
        for (places, s) in self.patch.lanes() {
            for i in 0..LANES {
                if s.load[i] > 0.0 {
                    let of = &mut soft[numbers[places[i] as usize] as usize];
                    of.stiffness += s.stiffness[i];
                    of.damping += s.damping[i];
                }
            }
        }
    }

    /// Computes the softening of each triangle in contact by the springs under it; `contact_forces`
    /// are those of the current loads.
    fn soften(&mut self, spring_wall: Option<&SpringWall>, h: f64) {
        let Some(spring_wall) = spring_wall else { return };
        let mut places = std::mem::take(&mut self.places);
        places.clear();
        for eight in self.patch.facet_loads.chunks(LANES) {
            for corner in 0..3 {
                let mut place = [[0.0; LANES]; 3];
                for (i, on_facet) in eight.iter().enumerate() {
                    put(&mut place, i, self.vertex(self.corner(on_facet, corner)).0);
                }
                places.push(place);
            }
        }
        attenuate(spring_wall, &places, &self.contact_forces, &mut self.forces);
        self.places = places;
        let give = spring_wall.give(h);
        for number in 0..self.patch.facet_loads.len() {
            let on_facet = &self.patch.facet_loads[number];
            let (mut felt, mut lead) = (DVec3::ZERO, DVec3::ZERO);
            for corner in 0..3 {
                let force = at(&self.forces[number / LANES * 3 + corner], number % LANES);
                let vertex = &self.wall_displacement[self.corner(on_facet, corner) as usize];
                let moved = give * (force - spring_wall.spring * vertex.displacement);
                felt += force / 3.0;
                lead += (vertex.velocity - moved / h) / 3.0;
            }
            let ratio = (felt.dot(on_facet.normal) / on_facet.load).max(1.0);
            let of = &mut self.series.soft[number];
            of.share = 1.0 / (1.0 + (of.stiffness + of.damping / h) * give * ratio);
            of.lead = on_facet.normal.dot(lead);
        }
    }

    /// Vertex at a corner of a triangle in contact.
    fn corner(&self, on_facet: &FacetLoad, corner: usize) -> u32 {
        self.near.vertices[self.near.corners[on_facet.place as usize][corner] as usize]
    }

    /// Force after a change of twist, linear about it: pieces out of contact exert none.
    pub fn force_after(&self, change: &[f64; 6]) -> WallForce {
        let mut sums = Sums::default();
        add_answers(&mut sums, &self.patch.samples, &self.series.answers, change);
        let mut answer = WallForce { force: [0.0; 6], slope: [[0.0; 6]; 6] };
        for row in 0..6 {
            answer.force[row] = sum(&sums.force[row]);
            for column in 0..=row {
                answer.slope[row][column] = sum(&sums.slope[row][column]);
            }
        }
        answer
    }

    /// Sets the loads of the first `count` triangles in contact after a change of twist.
    pub fn load_facets(&mut self, count: usize, change: &[f64; 6]) {
        let Series { answers, numbers, .. } = &self.series;
        let (lanes, loads) = self.patch.lanes_and_loads();
        loads[..count].iter_mut().for_each(|on_facet| on_facet.load = 0.0);
        for ((places, s), answer) in lanes.zip(answers) {
            for i in 0..LANES {
                if s.load[i] > 0.0 {
                    let number = numbers[places[i] as usize] as usize;
                    loads[number].load += answer.load(s, i, change);
                }
            }
        }
    }

    /// Displaces the springs under `contact_forces` by a fraction of a part of `h` [s].
    pub fn relax(&mut self, wall: &Wall, spring_wall: &SpringWall, h: f64, share: f64) {
        self.awaken(wall, spring_wall);
        self.move_awake(spring_wall, share, |vertex, force| {
            let moved = spring_wall.give(h) * (force - spring_wall.spring * vertex.displacement);
            vertex.displacement += share * moved;
            vertex.velocity = moved / h;
            moved
        });
    }

    /// Distance that the capsule can move without contact [m]; 0 if contact is possible now.
    pub fn free_way(&self) -> f64 {
        let least = self.clear.iter().fold(f64::INFINITY, |least, &clear| least.min(clear));
        (least - self.travel).clamp(0.0, MARGIN)
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn add_answers(sums: &mut Sums, samples: &[Samples], answers: &[Answer], change: &[f64; 6]) {
    for (s, answer) in samples.iter().zip(answers) {
        let (mut slope, mut force) = ([0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let holds = answer.load(s, i, change) > 0.0;
            slope[i] = if holds { answer.slope[i] } else { 0.0 };
            force[i] = if holds { answer.base[i] } else { 0.0 };
        }
        sums.add(&s.lever, &force, &slope);
    }
}
