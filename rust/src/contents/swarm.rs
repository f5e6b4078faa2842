//! Spheres in motion: they rise, sink, drift, cling to the wall and give way to the capsule.

use super::SphereArrays;
use super::around::{Around, Surroundings};
use super::capsule::Capsule;
use super::drag::Medium;
use crate::mucosa::noise::uniform;
use crate::wall::Wall;
use crate::wall::query;
use glam::DVec3;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2, ndarray::Array2};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Least height of a sphere's centre over the wall, as a share of its radius.
const CLING: f64 = 0.6;
/// Least height of a bubble's centre over the wall while it rides, as a share of its radius; where
/// the wall is nearer it wipes the bubble off.
const WIPED: f64 = 0.2;
/// Share of the speed of approach that is left after a bounce.
pub const BOUNCE: f64 = 0.3;
/// Distance from the capsule within which spheres move in every piece of a sweep [m].
const BESIDE: f64 = 5e-3;
/// Tell draws for different purposes apart.
const LANDING: u32 = 0x9e37_79b9;
const RELEASE: u32 = 0x85eb_ca6b;
/// Density of gas [kg/m³].
const GAS: f64 = 1.2;
/// Share of the displaced liquid that moves with a sphere (added mass, Lamb 1932, art. 92).
const ADDED: f64 = 0.5;

/// What does not change about a sphere.
pub struct Kind {
    pub radius: f64,
    pub is_bubble: bool,
    /// Where it was put at first, and where another one forms when it bursts [m].
    home: DVec3,
    home_arc: f64,
    /// Height of its centre over the wall while it clings [m].
    height: f64,
}

/// Where a sphere is and how it moves.
#[derive(Clone, Copy)]
pub struct Float {
    pub position: DVec3,
    pub velocity: DVec3,
    arc_length: f64,
    /// Where it sits on the capsule, in its frame about its centre of mass [m]; 0 for one that
    /// does not.
    pub seat: DVec3,
}

/// Laws of all spheres.
#[derive(FromPyObject)]
struct SwarmLaws {
    liquid_density: f64,
    viscosity: f64,
    chyme_density: f64,
    burst_rate: f64,
    landing_rate: f64,
    release_rate: f64,
    drift: f64,
    reach: f64,
    seed: u32,
}

/// Tangents of the centreline at equal distances.
struct Course {
    tangents: Vec<DVec3>,
    spacing: f64,
}

/// Bubbles and particles that move.
#[pyclass(module = "vrcaps._core")]
pub struct Swarm {
    kinds: Vec<Kind>,
    floats: Vec<Float>,
    laws: SwarmLaws,
    course: Course,
    /// Which spheres move in every piece of the sweep under way; empty between sweeps.
    beside: Vec<bool>,
    /// Steps so far: the counter of all random draws.
    #[pyo3(get, set)]
    count: u32,
}

/// One step's constants.
struct Step<'a> {
    wall: &'a Wall,
    laws: &'a SwarmLaws,
    course: &'a Course,
    around: &'a Around,
    count: u32,
    capsule: &'a Capsule,
}

fn vector(a: [f64; 3]) -> DVec3 {
    DVec3::from_array(a)
}

#[pymethods]
impl Swarm {
    /// Takes spheres at rest in the wall's outside world, and tangents [k 3] of the centreline.
    #[new]
    fn new(
        wall: &Wall,
        spheres: SphereArrays<'_>,
        laws: SwarmLaws,
        tangents: PyReadonlyArray2<'_, f64>,
        spacing: f64,
    ) -> PyResult<Self> {
        let kind = spheres.kind.as_array().to_vec();
        let all = super::read(wall, &spheres)?;
        let kinds: Vec<Kind> = all
            .par_iter()
            .map(|s| Kind {
                height: f64::from(query::nearest(&wall.bvh, s.center).distance),
                radius: f64::from(s.radius),
                is_bubble: kind[s.number as usize] == super::BUBBLE,
                home: vector(s.center.map(f64::from)),
                home_arc: f64::from(s.arc_length),
            })
            .collect();
        let rows = tangents.as_array();
        let tangents = rows.outer_iter().map(|r| DVec3::new(r[0], r[1], r[2])).collect();
        let floats = kinds.iter().map(Float::at_home).collect();
        let course = Course { tangents, spacing };
        Ok(Swarm { kinds, floats, laws, course, beside: Vec::new(), count: 0 })
    }

    /// Moves on by `dt`; returns the impulse [N·s] on the capsule and its moment about `center`.
    ///
    /// Pieces of time may be bound to a sweep: all but the last have a `sweep` of 0, the last has
    /// the time of all. What is far from the capsule then moves once a sweep.
    #[pyo3(signature = (wall, around, dt, sweep=None))]
    fn step(
        &mut self,
        py: Python<'_>,
        wall: &Wall,
        around: Surroundings<'_>,
        dt: f64,
        sweep: Option<f64>,
    ) -> ([f64; 3], [f64; 3]) {
        let (around, mut capsule) = (around.read(), around.capsule());
        let sweep = sweep.unwrap_or(dt);
        py.detach(|| self.advance(wall, &around, &mut capsule, [dt, sweep]));
        self.count = self.count.wrapping_add(1);
        (capsule.impulse.to_array(), capsule.moment.to_array())
    }

    /// Position about the wall's centre [m], velocity [m/s] and gut coordinate [m] of each, and its
    /// seat on the capsule [m], [n 10].
    #[getter]
    fn floats<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let flat: Vec<f64> = self
            .floats
            .iter()
            .flat_map(|f| {
                let (p, v, s) = (f.position, f.velocity, f.seat);
                [p.x, p.y, p.z, v.x, v.y, v.z, f.arc_length, s.x, s.y, s.z]
            })
            .collect();
        Array2::from_shape_vec((self.floats.len(), 10), flat).expect("whole rows").into_pyarray(py)
    }

    #[setter]
    fn set_floats(&mut self, floats: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let rows = floats.as_array();
        if rows.dim() != (self.floats.len(), 10) || !rows.iter().all(|x| x.is_finite()) {
            return Err(PyValueError::new_err("Floats are ten finite numbers for each sphere."));
        }
        for (float, r) in self.floats.iter_mut().zip(rows.outer_iter()) {
            *float = Float {
                position: DVec3::new(r[0], r[1], r[2]),
                velocity: DVec3::new(r[3], r[4], r[5]),
                arc_length: r[6],
                seat: DVec3::new(r[7], r[8], r[9]),
            };
        }
        self.beside.clear();
        Ok(())
    }

    /// Masses of all spheres, with the liquid that moves along [kg].
    fn masses(&self) -> Vec<f64> {
        self.kinds.iter().map(|kind| mass(&self.laws, kind)).collect()
    }
}

impl Swarm {
    /// One piece of a sweep: the spheres move, then the capsule meets them.
    fn advance(
        &mut self,
        wall: &Wall,
        around: &Around,
        capsule: &mut Capsule,
        [dt, sweep]: [f64; 2],
    ) {
        let (laws, kinds, floats) = (&self.laws, &self.kinds, &mut self.floats);
        let within = |p: DVec3, reach: f64| capsule.offset(p).length_squared() < reach * reach;
        if self.beside.is_empty() {
            let reach = |kind: &Kind| capsule.radius + kind.radius + BESIDE;
            let near = |(float, kind): (&Float, &Kind)| within(float.position, reach(kind));
            self.beside = floats.iter().zip(kinds).map(near).collect();
        }
        let step = Step { wall, laws, course: &self.course, around, count: self.count, capsule };
        let moving = floats.par_iter_mut().zip(kinds).zip(&self.beside).enumerate();
        moving.with_min_len(256).for_each(|(number, ((float, kind), &is_beside))| {
            let time = if is_beside || float.sits() { dt } else { sweep };
            if time > 0.0 && (float.sits() || within(float.position, laws.reach)) {
                step.advance(number as u32, kind, float, time);
            }
        });
        // In the order of their numbers: each push changes what the next one meets.
        for (number, (float, kind)) in (0..).zip(floats.iter_mut().zip(kinds)) {
            let lands = || draw(laws.seed ^ LANDING, number, self.count, laws.landing_rate * dt);
            if !float.sits() && capsule.meet(kind, float, mass(laws, kind), lands) {
                let seat = capsule.seat(float.position);
                (float.seat, float.velocity) = (seat, capsule.velocity_at(float.position));
            }
        }
        if sweep > 0.0 {
            self.beside.clear();
        }
    }
}

#[cfg(test)]
impl Kind {
    /// A sphere at a place.
    pub fn new(radius: f64, is_bubble: bool, home: DVec3) -> Self {
        Kind { radius, is_bubble, home, home_arc: 0.0, height: radius }
    }
}

impl Float {
    pub fn at_home(kind: &Kind) -> Self {
        let (velocity, seat) = (DVec3::ZERO, DVec3::ZERO);
        Float { position: kind.home, velocity, arc_length: kind.home_arc, seat }
    }

    /// Whether it sits on the capsule.
    fn sits(&self) -> bool {
        self.seat != DVec3::ZERO
    }
}

/// Whether something that has a chance happens to a sphere now.
fn draw(seed: u32, number: u32, count: u32, chance: f64) -> bool {
    f64::from(uniform(seed, number, count)) < chance
}

/// Speed upwards of a sphere in a liquid [m/s], see `Medium::terminal_speed`.
#[pyfunction]
pub fn terminal_speed(
    radius: f64,
    density: f64,
    liquid_density: f64,
    viscosity: f64,
    gravity: f64,
) -> f64 {
    Medium { density: liquid_density, viscosity }.terminal_speed(radius, density, gravity)
}

fn mass(laws: &SwarmLaws, kind: &Kind) -> f64 {
    let density = if kind.is_bubble { GAS } else { laws.chyme_density };
    4.0 / 3.0 * std::f64::consts::PI * kind.radius.powi(3) * (density + ADDED * laws.liquid_density)
}

impl Step<'_> {
    fn mass(&self, kind: &Kind) -> f64 {
        mass(self.laws, kind)
    }

    /// Moves one sphere on by `dt`; what it does depends on itself, the wall and the capsule.
    fn advance(&self, number: u32, kind: &Kind, float: &mut Float, dt: f64) {
        let laws = self.laws;
        if kind.is_bubble && draw(laws.seed, number, self.count, laws.burst_rate * dt) {
            *float = Float::at_home(kind);
        }
        let tangent = self.course.tangent(float.arc_length);
        let level = self.around.level(float.arc_length);
        let depth =
            |p: DVec3| level.map_or(f64::NEG_INFINITY, |level| level - self.around.up.dot(p));
        let is_wet = |p: DVec3| depth(p) > -0.5 * kind.radius;
        let before = float.position;
        if float.sits() {
            float.position = self.capsule.place(float.seat);
            float.velocity = self.capsule.velocity_at(float.position);
            let wet = is_wet(float.position);
            let chance = if wet { laws.release_rate * dt } else { 0.0 };
            let released = draw(laws.seed ^ RELEASE, number, self.count, chance);
            if released || self.wall_below(float.position).2 < WIPED * kind.radius {
                float.seat = DVec3::ZERO;
                self.touch_wall(kind, float, wet);
            }
        } else {
            let wanted = self.wanted(kind, tangent, depth(before), is_wet(before), dt);
            let keep =
                exp(-dt * self.medium().resistance(kind.radius, wanted.length()) / self.mass(kind));
            float.velocity = wanted + keep * (float.velocity - wanted);
            float.position += dt * float.velocity;
            self.touch_wall(kind, float, is_wet(before));
        }
        let way = if float.sits() { float.position - before } else { dt * float.velocity };
        float.arc_length = (float.arc_length + way.dot(tangent)).clamp(0.0, self.course.length());
    }

    /// Velocity at which a free sphere moves in the end [m/s], `depth` [m] below the level.
    fn wanted(&self, kind: &Kind, tangent: DVec3, depth: f64, wet: bool, dt: f64) -> DVec3 {
        let drift = self.laws.drift * tangent;
        if !wet {
            return drift;
        }
        let density = if kind.is_bubble { GAS } else { self.laws.chyme_density };
        let speed = self.medium().terminal_speed(kind.radius, density, self.around.gravity);
        // A sphere that rises stops with its middle in the surface.
        drift + speed.min(depth / dt) * self.around.up
    }

    fn medium(&self) -> Medium {
        Medium { density: self.laws.liquid_density, viscosity: self.laws.viscosity }
    }

    /// Nearest point of the wall, its normal into the lumen, and the height over it [m].
    fn wall_below(&self, position: DVec3) -> (DVec3, DVec3, f64) {
        let nearest = query::nearest(&self.wall.bvh, position.to_array().map(|x| x as f32));
        let point = vector(nearest.point.map(f64::from));
        let corners = self.wall.faces[nearest.face as usize];
        let sum: DVec3 = corners.iter().map(|&v| vector(self.wall.normal(v).map(f64::from))).sum();
        let inward = sum.normalize_or_zero();
        (point, inward, (position - point).dot(inward))
    }

    /// Keeps a sphere in the lumen; out of the liquid it clings at the height where it was put.
    fn touch_wall(&self, kind: &Kind, float: &mut Float, wet: bool) {
        let (point, inward, height) = self.wall_below(float.position);
        let least = CLING.min(kind.height / kind.radius) * kind.radius;
        if wet && height >= least {
            return;
        }
        // Straight off the wall, so that nothing creeps where the wall is at rest.
        let away =
            if height > 0.0 { (float.position - point).normalize_or(inward) } else { inward };
        float.position = point + if wet { least } else { kind.height } * away;
        let into = float.velocity.dot(inward);
        if into < 0.0 {
            float.velocity -= (1.0 + if wet { BOUNCE } else { 0.0 }) * into * inward;
        }
    }
}

impl Course {
    fn tangent(&self, arc_length: f64) -> DVec3 {
        let place = (arc_length / self.spacing) as usize;
        self.tangents[place.min(self.tangents.len() - 1)]
    }

    fn length(&self) -> f64 {
        self.spacing * (self.tangents.len() - 1) as f64
    }
}

/// eˣ for x ≤ 0, the same bits on every machine.
fn exp(x: f64) -> f64 {
    f64::from(crate::simd::f32x64::exp2((x * std::f64::consts::LOG2_E) as f32))
}
