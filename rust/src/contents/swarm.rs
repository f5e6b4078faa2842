//! Spheres in motion: they rise, sink, drift, cling to the wall and give way to the capsule.

use super::SphereArrays;
use super::drag::Medium;
use crate::lanes::Vec3;
use crate::mucosa::noise::uniform;
use crate::physics::body::Axis;
use crate::query;
use crate::wall::Wall;
use glam::DVec3;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2, ndarray::Array2};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Least height of a sphere's centre over the wall, as a share of its radius.
const CLING: f64 = 0.6;
/// Share of the speed of approach that is left after a bounce.
const BOUNCE: f64 = 0.3;
/// Density of gas [kg/m³].
const GAS: f64 = 1.2;
/// Share of the displaced liquid that moves with a sphere (added mass, Lamb 1932, art. 92).
const ADDED: f64 = 0.5;

/// What does not change about a sphere.
struct Kind {
    radius: f64,
    is_bubble: bool,
    /// Where it was put at first, and where another one forms when it bursts [m].
    home: DVec3,
    home_arc: f64,
    /// Height of its centre over the wall while it clings [m].
    height: f64,
}

/// Where a sphere is and how it moves.
#[derive(Clone, Copy)]
struct Float {
    position: DVec3,
    velocity: DVec3,
    arc_length: f64,
}

/// Laws of all spheres.
#[derive(FromPyObject)]
struct SwarmLaws {
    liquid_density: f64,
    viscosity: f64,
    chyme_density: f64,
    burst_rate: f64,
    drift: f64,
    reach: f64,
    seed: u32,
}

/// Everything around the spheres in one step; positions are about the wall's centre.
#[derive(FromPyObject)]
struct Surroundings<'py> {
    /// Unit direction against gravity.
    up: [f64; 3],
    /// Strength of gravity [m/s²].
    gravity: f64,
    /// Stretch [p 2] of each pool along the gut, and its level along `up` [m].
    stretch: PyReadonlyArray2<'py, f64>,
    levels: PyReadonlyArray1<'py, f64>,
    /// Ends of the capsule's axis [m].
    axis: [[f64; 3]; 2],
    radius: f64,
    mass: f64,
    center: [f64; 3],
    velocity: [f64; 3],
    spin: [f64; 3],
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
    /// Steps so far: the counter of all random draws.
    #[pyo3(get, set)]
    count: u32,
}

/// One step's constants.
struct Step<'a> {
    wall: &'a Wall,
    laws: &'a SwarmLaws,
    course: &'a Course,
    up: DVec3,
    gravity: f64,
    pools: Vec<([f64; 2], f64)>,
    count: u32,
    dt: f64,
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
        let at_home =
            |k: &Kind| Float { position: k.home, velocity: DVec3::ZERO, arc_length: k.home_arc };
        let rows = tangents.as_array();
        let tangents = rows.outer_iter().map(|r| DVec3::new(r[0], r[1], r[2])).collect();
        let floats = kinds.iter().map(at_home).collect();
        Ok(Swarm { kinds, floats, laws, course: Course { tangents, spacing }, count: 0 })
    }

    /// Moves on by `dt`; returns the impulse [N·s] on the capsule and its moment about `center`.
    fn step(
        &mut self,
        py: Python<'_>,
        wall: &Wall,
        around: Surroundings<'_>,
        dt: f64,
    ) -> ([f64; 3], [f64; 3]) {
        let (stretch, levels) = (around.stretch.as_array(), around.levels.as_array());
        let pools = stretch.outer_iter().zip(levels).map(|(s, &z)| ([s[0], s[1]], z)).collect();
        let step = Step {
            wall,
            laws: &self.laws,
            course: &self.course,
            up: vector(around.up),
            gravity: around.gravity,
            pools,
            count: self.count,
            dt,
        };
        let [start, end] = around.axis.map(vector);
        let square = (end - start).length_squared();
        let inverse_square = if square > 0.0 { 1.0 / square } else { 0.0 };
        let axis = Axis { start, span: end - start, inverse_square };
        let mut capsule = Capsule {
            axis,
            radius: around.radius,
            mass: around.mass,
            center: vector(around.center),
            velocity: vector(around.velocity),
            spin: vector(around.spin),
            impulse: DVec3::ZERO,
            moment: DVec3::ZERO,
        };
        let reach = self.laws.reach;
        let (kinds, floats) = (&self.kinds, &mut self.floats);
        py.detach(|| {
            let near = |p: DVec3| (p - axis.nearest(p)).length_squared() < reach * reach;
            let moving = floats.par_iter_mut().zip(kinds).enumerate().with_min_len(256);
            moving
                .filter(|(_, (float, _))| near(float.position))
                .for_each(|(number, (float, kind))| step.advance(number as u32, kind, float));
            // In the order of their numbers: each push changes what the next one meets.
            for (float, kind) in floats.iter_mut().zip(kinds) {
                if near(float.position) {
                    capsule.meet(kind, float, step.mass(kind));
                }
            }
        });
        self.count = self.count.wrapping_add(1);
        (capsule.impulse.to_array(), capsule.moment.to_array())
    }

    /// Position about the wall's centre [m], velocity [m/s] and gut coordinate [m] of each [n 7].
    #[getter]
    fn floats<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let flat: Vec<f64> = self
            .floats
            .iter()
            .flat_map(|f| {
                let (p, v) = (f.position, f.velocity);
                [p.x, p.y, p.z, v.x, v.y, v.z, f.arc_length]
            })
            .collect();
        Array2::from_shape_vec((self.floats.len(), 7), flat).expect("whole rows").into_pyarray(py)
    }

    #[setter]
    fn set_floats(&mut self, floats: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let rows = floats.as_array();
        if rows.dim() != (self.floats.len(), 7) || !rows.iter().all(|x| x.is_finite()) {
            return Err(PyValueError::new_err("Floats are seven finite numbers for each sphere."));
        }
        for (float, r) in self.floats.iter_mut().zip(rows.outer_iter()) {
            *float = Float {
                position: DVec3::new(r[0], r[1], r[2]),
                velocity: DVec3::new(r[3], r[4], r[5]),
                arc_length: r[6],
            };
        }
        Ok(())
    }

    /// Masses of all spheres, with the liquid that moves along [kg].
    fn masses(&self) -> Vec<f64> {
        self.kinds.iter().map(|kind| mass(&self.laws, kind)).collect()
    }
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

    /// Moves one sphere on; what it does depends on itself and the wall only.
    fn advance(&self, number: u32, kind: &Kind, float: &mut Float) {
        if kind.is_bubble && self.bursts(number) {
            let home =
                Float { position: kind.home, velocity: DVec3::ZERO, arc_length: kind.home_arc };
            *float = home;
        }
        let tangent = self.course.tangent(float.arc_length);
        let level = self.level(float.arc_length);
        let height = self.up.dot(float.position);
        let depth = level.map_or(f64::NEG_INFINITY, |level| level - height);
        let wet = depth > -0.5 * kind.radius;
        let medium = Medium { density: self.laws.liquid_density, viscosity: self.laws.viscosity };
        let mut wanted = self.laws.drift * tangent;
        if wet {
            let density = if kind.is_bubble { GAS } else { self.laws.chyme_density };
            let speed = medium.terminal_speed(kind.radius, density, self.gravity);
            // A sphere that rises stops with its middle in the surface.
            wanted += speed.min(depth / self.dt) * self.up;
        }
        let drag = medium.resistance(kind.radius, wanted.length());
        let keep = exp(-self.dt * drag / self.mass(kind));
        float.velocity = wanted + keep * (float.velocity - wanted);
        float.position += self.dt * float.velocity;
        float.arc_length += self.dt * float.velocity.dot(tangent);
        float.arc_length = float.arc_length.clamp(0.0, self.course.length());
        self.touch_wall(kind, float, wet);
    }

    /// Keeps a sphere in the lumen; out of the liquid it clings at the height where it was put.
    fn touch_wall(&self, kind: &Kind, float: &mut Float, wet: bool) {
        let place: Vec3 = float.position.to_array().map(|x| x as f32);
        let nearest = query::nearest(&self.wall.bvh, place);
        let point = vector(nearest.point.map(f64::from));
        let corners = self.wall.faces[nearest.face as usize];
        let sum: DVec3 =
            corners.iter().map(|&v| vector(self.wall.normals[v as usize].map(f64::from))).sum();
        let inward = sum.normalize_or_zero();
        let offset = float.position - point;
        let height = offset.dot(inward);
        let least = CLING.min(kind.height / kind.radius) * kind.radius;
        if wet && height >= least {
            return;
        }
        // Straight off the wall, so that nothing creeps where the wall is at rest.
        let away = if height > 0.0 { offset.normalize_or(inward) } else { inward };
        float.position = point + if wet { least } else { kind.height } * away;
        let into = float.velocity.dot(inward);
        if into < 0.0 {
            float.velocity -= (1.0 + if wet { BOUNCE } else { 0.0 }) * into * inward;
        }
    }

    fn bursts(&self, number: u32) -> bool {
        f64::from(uniform(self.laws.seed, number, self.count)) < self.laws.burst_rate * self.dt
    }

    fn level(&self, arc_length: f64) -> Option<f64> {
        let holds = |stretch: &[f64; 2]| (stretch[0]..=stretch[1]).contains(&arc_length);
        self.pools.iter().find(|(stretch, _)| holds(stretch)).map(|(_, level)| *level)
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

/// The capsule as the spheres meet it.
struct Capsule {
    axis: Axis,
    radius: f64,
    mass: f64,
    center: DVec3,
    velocity: DVec3,
    spin: DVec3,
    impulse: DVec3,
    moment: DVec3,
}

impl Capsule {
    /// Pushes a sphere out of the way; the capsule gets the opposite impulse.
    ///
    /// The impulse along the normal n that leaves the share e of the speed of approach,
    /// J = (1 + e) n·(v_c − v) m M / (m + M), with the capsule's whole mass M.
    fn meet(&mut self, kind: &Kind, float: &mut Float, mass: f64) {
        let foot = self.axis.nearest(float.position);
        let away = float.position - foot;
        let distance = away.length();
        let reach = self.radius + kind.radius;
        if distance >= reach || distance == 0.0 {
            return;
        }
        let normal = away / distance;
        float.position = foot + reach * normal;
        let place = foot + self.radius * normal;
        let lever = place - self.center;
        let capsule = self.velocity + self.spin.cross(lever);
        let approach = (capsule - float.velocity).dot(normal);
        if approach <= 0.0 {
            return;
        }
        let impulse = (1.0 + BOUNCE) * approach * mass * self.mass / (mass + self.mass);
        float.velocity += impulse / mass * normal;
        self.velocity -= impulse / self.mass * normal;
        self.impulse -= impulse * normal;
        self.moment -= lever.cross(impulse * normal);
    }
}

/// eˣ for x ≤ 0, the same bits on every machine.
fn exp(x: f64) -> f64 {
    f64::from(crate::lanes::exp2((x * std::f64::consts::LOG2_E) as f32))
}
