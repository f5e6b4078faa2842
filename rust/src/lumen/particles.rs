//! Motion of spheres: they rise, sink, drift, adhere to the wall and yield to the capsule.

use super::capsule::Capsule;
use super::drag::Medium;
use super::particle::{BOUNCE, Kind, ParticleState};
use super::particle_contact::push_apart;
use super::spheres::{BUBBLE, SphereArrays};
use super::step_inputs::{Around, StepInputs};
use crate::mucosa::noise::uniform;
use crate::pool::{install, map};
use crate::wall::Wall;
use crate::wall::query;
use glam::DVec3;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2, ndarray::Array2};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Minimum height of a sphere's center above the wall, as a fraction of its radius.
const CLING: f64 = 0.6;
/// Minimum height of an attached bubble's center above the wall, as a fraction of its radius; a
/// nearer wall wipes the bubble off.
const WIPED: f64 = 0.2;
/// Distance from the capsule within which spheres move in every substep of a sweep [m].
const BESIDE: f64 = 5e-3;
/// Distinguish random draws for different purposes.
const LANDING: u32 = 0x9e37_79b9;
const RELEASE: u32 = 0x85eb_ca6b;
/// Number of spheres that a thread moves at a time.
const PART: usize = 256;
/// Density of gas [kg/m³].
const GAS: f64 = 1.2;
/// Fraction of the displaced liquid that moves with a sphere (added mass, Lamb 1932, art. 92).
const ADDED: f64 = 0.5;

/// Parameters of all spheres.
#[derive(FromPyObject)]
struct ParticleLaws {
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

/// Tangents of the centerline at uniform distances.
struct Course {
    tangents: Vec<DVec3>,
    spacing: f64,
}

/// Bubbles and particles that move.
#[pyclass(module = "vrcaps._core")]
pub struct Particles {
    kinds: Vec<Kind>,
    states: Vec<ParticleState>,
    laws: ParticleLaws,
    course: Course,
    /// True for spheres that move in every substep of the current sweep; empty between sweeps.
    beside: Vec<bool>,
    /// Number of steps so far: the counter of all random draws.
    #[pyo3(get, set)]
    count: u32,
}

/// One step's constants.
struct Step<'a> {
    wall: &'a Wall,
    laws: &'a ParticleLaws,
    course: &'a Course,
    around: &'a Around,
    count: u32,
    capsule: &'a Capsule,
}

fn vector(a: [f64; 3]) -> DVec3 {
    DVec3::from_array(a)
}

#[pymethods]
impl Particles {
    /// Creates spheres at rest in the wall's outside world, with tangents [k 3] of the centerline.
    #[new]
    fn new(
        py: Python<'_>,
        wall: &Wall,
        spheres: SphereArrays<'_>,
        laws: ParticleLaws,
        tangents: PyReadonlyArray2<'_, f64>,
        spacing: f64,
    ) -> PyResult<Self> {
        let kind = spheres.kind.as_array().to_vec();
        let all = spheres.read(wall)?;
        let kinds: Vec<Kind> = map(py, &all, 1, |s| Kind {
            height: f64::from(query::nearest(&wall.bvh, s.center).distance),
            radius: f64::from(s.radius),
            is_bubble: kind[s.number as usize] == BUBBLE,
            home: vector(s.center.map(f64::from)),
            home_arc: f64::from(s.arc_length),
        });
        let rows = tangents.as_array();
        let tangents = rows.outer_iter().map(|r| DVec3::new(r[0], r[1], r[2])).collect();
        let states = kinds.iter().map(ParticleState::at_home).collect();
        let course = Course { tangents, spacing };
        Ok(Particles { kinds, states, laws, course, beside: Vec::new(), count: 0 })
    }

    /// Advances by `dt`; returns the impulse [N·s] on the capsule and its moment about `center`.
    ///
    /// Substeps may form a sweep: all but the last have a `sweep` of 0, the last has the total
    /// time. Spheres far from the capsule then move once per sweep.
    #[pyo3(signature = (wall, around, dt, sweep=None))]
    fn step(
        &mut self,
        py: Python<'_>,
        wall: &Wall,
        around: StepInputs<'_>,
        dt: f64,
        sweep: Option<f64>,
    ) -> ([f64; 3], [f64; 3]) {
        let (around, mut capsule) = (around.read(), around.capsule());
        let sweep = sweep.unwrap_or(dt);
        py.detach(|| self.advance(wall, &around, &mut capsule, [dt, sweep]));
        self.count = self.count.wrapping_add(1);
        (capsule.impulse.to_array(), capsule.moment.to_array())
    }

    /// Position relative to the wall's center [m], velocity [m/s] and gut coordinate [m] of each,
    /// and its site on the capsule [m], [n 10].
    #[getter]
    fn states<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let flat: Vec<f64> = self
            .states
            .iter()
            .flat_map(|f| {
                let (p, v, s) = (f.position, f.velocity, f.site);
                [p.x, p.y, p.z, v.x, v.y, v.z, f.arc_length, s.x, s.y, s.z]
            })
            .collect();
        Array2::from_shape_vec((self.states.len(), 10), flat).expect("whole rows").into_pyarray(py)
    }

    #[setter]
    fn set_states(&mut self, states: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let rows = states.as_array();
        if rows.dim() != (self.states.len(), 10) || !rows.iter().all(|x| x.is_finite()) {
            return Err(PyValueError::new_err("States are ten finite values for each sphere."));
        }
        for (state, r) in self.states.iter_mut().zip(rows.outer_iter()) {
            *state = ParticleState {
                position: DVec3::new(r[0], r[1], r[2]),
                velocity: DVec3::new(r[3], r[4], r[5]),
                arc_length: r[6],
                site: DVec3::new(r[7], r[8], r[9]),
            };
        }
        self.beside.clear();
        Ok(())
    }

    /// Masses of all spheres, including the added mass of liquid [kg].
    fn masses(&self) -> Vec<f64> {
        self.kinds.iter().map(|kind| mass(&self.laws, kind)).collect()
    }
}

impl Particles {
    /// Performs one substep of a sweep: the spheres move, then the capsule collides with them.
    fn advance(
        &mut self,
        wall: &Wall,
        around: &Around,
        capsule: &mut Capsule,
        [dt, sweep]: [f64; 2],
    ) {
        let (laws, kinds, states) = (&self.laws, &self.kinds, &mut self.states);
        let within = |p: DVec3, reach: f64| capsule.offset(p).length_squared() < reach * reach;
        if self.beside.is_empty() {
            let reach = |kind: &Kind| capsule.radius + kind.radius + BESIDE;
            let near = |(state, kind): (&ParticleState, &Kind)| within(state.position, reach(kind));
            self.beside = states.iter().zip(kinds).map(near).collect();
        }
        let step = Step { wall, laws, course: &self.course, around, count: self.count, capsule };
        let beside = &self.beside;
        let advance = |first: usize, states: &mut [ParticleState]| {
            for (number, state) in (first..).zip(states) {
                let time = if beside[number] || state.sits() { dt } else { sweep };
                if time > 0.0 && (state.sits() || within(state.position, laws.reach)) {
                    step.advance(number as u32, &kinds[number], state, time);
                }
            }
        };
        if states.len() < 2 * PART {
            advance(0, states);
        } else {
            let parts = states.par_chunks_mut(PART).enumerate();
            install(|| parts.for_each(|(part, states)| advance(PART * part, states)));
        }
        let moved = |k: usize, s: &ParticleState| {
            (beside[k] || sweep > 0.0) && within(s.position, laws.reach)
        };
        push_apart(kinds, states, |kind| mass(laws, kind), moved);
        // In the order of their indices, because each collision changes the next.
        for (number, (state, kind)) in (0..).zip(states.iter_mut().zip(kinds)) {
            let lands = || draw(laws.seed ^ LANDING, number, self.count, laws.landing_rate * dt);
            if !state.sits() && capsule.meet(kind, state, mass(laws, kind), lands) {
                let site = capsule.site(state.position);
                (state.site, state.velocity) = (site, capsule.velocity_at(state.position));
            }
        }
        if sweep > 0.0 {
            self.beside.clear();
        }
    }
}

/// True if an event of the given probability happens to a sphere in this step.
fn draw(seed: u32, number: u32, count: u32, chance: f64) -> bool {
    f64::from(uniform(seed, number, count)) < chance
}

/// Upward speed of a sphere in a liquid [m/s], see `Medium::terminal_speed`.
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

fn mass(laws: &ParticleLaws, kind: &Kind) -> f64 {
    let density = if kind.is_bubble { GAS } else { laws.chyme_density };
    4.0 / 3.0 * std::f64::consts::PI * kind.radius.powi(3) * (density + ADDED * laws.liquid_density)
}

impl Step<'_> {
    fn mass(&self, kind: &Kind) -> f64 {
        mass(self.laws, kind)
    }

    /// Advances one sphere by `dt`, depending only on itself, the wall and the capsule.
    fn advance(&self, number: u32, kind: &Kind, state: &mut ParticleState, dt: f64) {
        let laws = self.laws;
        if kind.is_bubble && draw(laws.seed, number, self.count, laws.burst_rate * dt) {
            *state = ParticleState::at_home(kind);
        }
        let tangent = self.course.tangent(state.arc_length);
        let level = self.around.level(state.arc_length);
        let depth =
            |p: DVec3| level.map_or(f64::NEG_INFINITY, |level| level - self.around.up.dot(p));
        let is_wet = |p: DVec3| depth(p) > -0.5 * kind.radius;
        let before = state.position;
        if state.sits() {
            state.position = self.capsule.place(state.site);
            state.velocity = self.capsule.velocity_at(state.position);
            let wet = is_wet(state.position);
            let chance = if wet { laws.release_rate * dt } else { 0.0 };
            let released = draw(laws.seed ^ RELEASE, number, self.count, chance);
            if released || self.wall_below(state.position).2 < WIPED * kind.radius {
                state.site = DVec3::ZERO;
                self.touch_wall(kind, state, wet);
            }
        } else {
            let wanted = self.wanted(kind, tangent, depth(before), is_wet(before), dt);
            let keep =
                exp(-dt * self.medium().resistance(kind.radius, wanted.length()) / self.mass(kind));
            state.velocity = wanted + keep * (state.velocity - wanted);
            state.position += dt * state.velocity;
            self.touch_wall(kind, state, is_wet(before));
        }
        let displacement = if state.sits() { state.position - before } else { dt * state.velocity };
        state.arc_length =
            (state.arc_length + displacement.dot(tangent)).clamp(0.0, self.course.length());
    }

    /// Terminal velocity of a free sphere [m/s], `depth` [m] below the level.
    fn wanted(&self, kind: &Kind, tangent: DVec3, depth: f64, wet: bool, dt: f64) -> DVec3 {
        let drift = self.laws.drift * tangent;
        if !wet {
            return drift;
        }
        let density = if kind.is_bubble { GAS } else { self.laws.chyme_density };
        let speed = self.medium().terminal_speed(kind.radius, density, self.around.gravity);
        // A rising sphere stops with its center in the surface.
        drift + speed.min(depth / dt) * self.around.up
    }

    fn medium(&self) -> Medium {
        Medium { density: self.laws.liquid_density, viscosity: self.laws.viscosity }
    }

    /// Nearest point of the wall, its normal into the lumen, and the height above it [m].
    fn wall_below(&self, position: DVec3) -> (DVec3, DVec3, f64) {
        let nearest = query::nearest(&self.wall.bvh, position.to_array().map(|x| x as f32));
        let point = vector(nearest.point.map(f64::from));
        let corners = self.wall.faces[nearest.face as usize];
        let sum: DVec3 = corners.iter().map(|&v| vector(self.wall.normal(v).map(f64::from))).sum();
        let inward = sum.normalize_or_zero();
        (point, inward, (position - point).dot(inward))
    }

    /// Keeps a sphere in the lumen; out of the liquid it adheres at its initial height.
    fn touch_wall(&self, kind: &Kind, state: &mut ParticleState, wet: bool) {
        let (point, inward, height) = self.wall_below(state.position);
        let least = CLING.min(kind.height / kind.radius) * kind.radius;
        if wet && height >= least {
            return;
        }
        // Along the normal of the wall, so that spheres do not creep on a wall at rest.
        let away =
            if height > 0.0 { (state.position - point).normalize_or(inward) } else { inward };
        state.position = point + if wet { least } else { kind.height } * away;
        let into = state.velocity.dot(inward);
        if into < 0.0 {
            state.velocity -= (1.0 + if wet { BOUNCE } else { 0.0 }) * into * inward;
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

/// eˣ for x ≤ 0, bit-identical on every machine.
fn exp(x: f64) -> f64 {
    f64::from(crate::simd::f32x64::exp2((x * std::f64::consts::LOG2_E) as f32))
}
