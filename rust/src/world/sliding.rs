//! Friction of the triangles in contact against a capsule's twist, in SIMD lanes.

use super::contact_patch::FacetLoad;
use super::solve::{Symmetric6, Twist};
use crate::simd::f64x8::{LANES, Lane, Lane3, at, max, put, sum};
use glam::DVec3;

/// Speed below which sliding is regularized, as creep under less friction than the limit [m/s].
pub const CREEP: f64 = 1e-5;

/// Eight triangles in frictional contact.
#[derive(Clone)]
struct Grips {
    /// Vector from the center of mass to the center of pressure [m].
    arm: Lane3,
    /// Unit normal of the capsule there.
    normal: Lane3,
    /// Velocity of the wall there [m/s].
    velocity: Lane3,
    /// Friction limit [N]; 0 in an unused lane.
    limit: Lane,
    /// Speed at which the limit is reached [m/s].
    creep: Lane,
}

const NO_GRIPS: Grips = Grips {
    arm: [[0.0; LANES]; 3],
    normal: [[0.0; LANES]; 3],
    velocity: [[0.0; LANES]; 3],
    limit: [0.0; LANES],
    creep: [CREEP; LANES],
};

/// All triangles in frictional contact.
pub struct Grip(Vec<Grips>);

/// Sliding of one triangle at one twist.
struct Slip {
    arm: DVec3,
    /// Velocity of the capsule along the wall [m/s].
    velocity: DVec3,
    speed: f64,
    /// Friction divided by speed [N·s/m].
    by_speed: f64,
}

impl FacetLoad {
    /// Coulomb friction on the wall [N] under a capsule about `position`.
    pub fn friction_on_wall(&self, friction: f64, position: DVec3, twist: &Twist) -> DVec3 {
        let slip = twist.linear + twist.angular.cross(self.center - position) - self.velocity;
        let slip = slip - self.normal * slip.dot(self.normal);
        let limit = friction * self.load;
        slip * (limit / slip.length().max(CREEP + self.mobility * limit))
    }
}

impl Grip {
    /// Grip of triangles with a coefficient of friction on a capsule about `position`.
    pub fn new(facet_loads: &[FacetLoad], friction: f64, position: DVec3) -> Self {
        let held = if friction > 0.0 { facet_loads } else { &[] };
        let mut grips = vec![NO_GRIPS; held.len().div_ceil(LANES)];
        for (k, on_facet) in held.iter().enumerate() {
            let (eight, i) = (&mut grips[k / LANES], k % LANES);
            put(&mut eight.arm, i, on_facet.center - position);
            put(&mut eight.normal, i, on_facet.normal);
            put(&mut eight.velocity, i, on_facet.velocity);
            eight.limit[i] = friction * on_facet.load;
            eight.creep[i] = CREEP + on_facet.mobility * eight.limit[i];
        }
        Grip(grips)
    }

    /// Force and torque on the capsule.
    pub fn force(&self, twist: &Twist) -> Twist {
        let mut sums = [[0.0; LANES]; 6];
        add_forces(&self.0, twist, &mut sums);
        Twist::from_array(sums.map(|lane| -sum(&lane)))
    }

    /// Adds the decrease of their impulse over `dt` by the twist.
    pub fn add_slope(&self, twist: &Twist, dt: f64, slope: &mut Symmetric6) {
        let mut sums = [[[0.0; LANES]; 6]; 6];
        add_slopes(&self.0, twist, &mut sums);
        for row in 0..6 {
            for column in 0..=row {
                slope.0[row][column] += dt * sum(&sums[row][column]);
            }
        }
    }
}

impl Grips {
    #[inline(always)]
    fn slip(&self, i: usize, twist: &Twist) -> Slip {
        let (arm, normal) = (at(&self.arm, i), at(&self.normal, i));
        let slip = twist.linear + twist.angular.cross(arm) - at(&self.velocity, i);
        let velocity = slip - normal * slip.dot(normal);
        let speed = velocity.length();
        Slip { arm, velocity, speed, by_speed: self.limit[i] / max(speed, self.creep[i]) }
    }

    /// Jacobian of friction by the twist, rows of force and then of torque. At its limit, friction
    /// only rotates with the slip; below, it is linear.
    #[inline(always)]
    fn slope(&self, i: usize, twist: &Twist) -> [[f64; 6]; 6] {
        let Slip { arm, velocity, speed, by_speed } = self.slip(i, twist);
        let along = if speed > self.creep[i] { by_speed / (speed * speed) } else { 0.0 };
        let n = at(&self.normal, i);
        let column = |e: DVec3, n_e: f64, v_e: f64| {
            let force = (e - n * n_e) * by_speed - velocity * (v_e * along);
            Twist { linear: force, angular: arm.cross(force) }
        };
        let x = column(DVec3::X, n.x, velocity.x);
        let y = column(DVec3::Y, n.y, velocity.y);
        let z = column(DVec3::Z, n.z, velocity.z);
        let row = |a: f64, b: f64, c: f64| {
            let force = DVec3::new(a, b, c);
            Twist { linear: force, angular: arm.cross(force) }.to_array()
        };
        [
            row(x.linear.x, y.linear.x, z.linear.x),
            row(x.linear.y, y.linear.y, z.linear.y),
            row(x.linear.z, y.linear.z, z.linear.z),
            row(x.angular.x, y.angular.x, z.angular.x),
            row(x.angular.y, y.angular.y, z.angular.y),
            row(x.angular.z, y.angular.z, z.angular.z),
        ]
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn add_forces(grips: &[Grips], twist: &Twist, sums: &mut [Lane; 6]) {
    for eight in grips {
        for i in 0..LANES {
            let slip = eight.slip(i, twist);
            let force = slip.velocity * slip.by_speed;
            let moment = slip.arm.cross(force);
            for d in 0..3 {
                sums[d][i] += force[d];
                sums[3 + d][i] += moment[d];
            }
        }
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn add_slopes(grips: &[Grips], twist: &Twist, sums: &mut [[Lane; 6]; 6]) {
    for eight in grips {
        for i in 0..LANES {
            let slope = eight.slope(i, twist);
            for row in 0..6 {
                for column in 0..=row {
                    sums[row][column][i] += slope[row][column];
                }
            }
        }
    }
}
