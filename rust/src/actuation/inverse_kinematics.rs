//! Closed-form inverse kinematics of arms like the Franka Emika Panda, with the last joint's angle
//! as the free parameter; derived from the geometry as He and Liu (ICCMA 2021) propose.
//!
//! The axes of joints 1 to 3 meet in the shoulder S, those of 5 and 6 in the wrist W. Given q7, the
//! frame of joint 6 is known, and with it W. Shoulder, elbow and wrist are a triangle of known
//! sides: two angles q4. The forearm's axis z5 leaves W at the angle of that triangle and is
//! perpendicular to z6: a cone cut by a plane, two lines. Each gives the whole elbow frame, q5 and
//! q6, and the spherical shoulder two triples q1, q2, q3: up to eight branches.

use super::kinematic_chain::{Chain, Pose};
use glam::{DMat3, DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Number of joints of such an arm.
pub const JOINTS: usize = 7;
/// Maximum number of branches for one q7.
pub const BRANCHES: usize = 8;
/// Angles of the seven joints [rad].
pub type Angles = [f64; JOINTS];

/// Tolerance of the joint limits for rounding [rad].
const SLACK: f64 = 1e-12;
/// Tolerance for rounding of a cosine beyond 1.
const ROUNDING: f64 = 1e-13;
/// Sine below which a direction is undefined.
const PARALLEL: f64 = 1e-9;
/// Numbers of angles q7 on either side, in the first and the finest search; denser near the start.
const SEARCH: (usize, usize) = (32, 512);
/// Distance below which a solution counts as the nearest to the current angles [rad, Euclidean].
const NEIGHBOR: f64 = 0.25;
/// Maximum number of steps along the self-motion towards the nearest solution.
const REFINE: usize = 40;
/// Relative decrease of the squared distance below which the steps end.
const CONVERGED: f64 = 1e-6;

/// Lengths of an arm with this geometry.
#[derive(Clone, Debug)]
pub struct Inverse {
    d1: f64,
    d3: f64,
    a4: f64,
    a5: f64,
    d5: f64,
    /// Angle of q4 at which shoulder and wrist are in line with the elbow.
    q4_offset: f64,
    /// Pose of joint 7's frame in the flange.
    flange_seven: Pose,
    chain: Chain,
}

/// Receiver of branches.
pub trait Branches {
    /// Angles that branches are compared with; they set q1 if it is free.
    fn near(&self) -> &Angles;
    /// Squared distance from `near` beyond which branches are rejected.
    fn bound2(&self) -> f64;
    /// Adds a branch.
    fn push(&mut self, angles: Angles);
}

/// All branches for one q7.
#[derive(Default)]
pub struct All {
    /// Joint angles.
    pub angles: [Angles; BRANCHES],
    /// Number of branches.
    pub count: usize,
}

impl Branches for All {
    fn near(&self) -> &Angles {
        &[0.0; JOINTS]
    }
    fn bound2(&self) -> f64 {
        f64::INFINITY
    }
    fn push(&mut self, angles: Angles) {
        self.angles[self.count] = angles;
        self.count += 1;
    }
}

/// Branch nearest to given angles.
#[derive(Clone, Copy)]
struct Nearest<'a> {
    near: &'a Angles,
    best: Angles,
    bound2: f64,
}

impl<'a> Nearest<'a> {
    fn new(near: &'a Angles, bound2: f64) -> Self {
        Nearest { near, best: [f64::NAN; JOINTS], bound2 }
    }

    fn found(&self) -> Option<Angles> {
        self.best[0].is_finite().then_some(self.best)
    }
}

impl Branches for Nearest<'_> {
    fn near(&self) -> &Angles {
        self.near
    }
    fn bound2(&self) -> f64 {
        self.bound2
    }
    fn push(&mut self, angles: Angles) {
        let distance2 = distance2(&angles, self.near);
        if distance2 < self.bound2 {
            (self.best, self.bound2) = (angles, distance2);
        }
    }
}

fn square(x: f64) -> f64 {
    x * x
}

fn distance2(a: &Angles, b: &Angles) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}

impl Inverse {
    /// Solver of a chain, or `None` if its geometry differs.
    pub fn new(chain: &Chain) -> Option<Self> {
        let j = &chain.joints;
        if j.len() != JOINTS || j.iter().any(|joint| joint.placement.is_some()) {
            return None;
        }
        let twists = [0.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0].map(|t| t * FRAC_PI_2);
        let twisted = j.iter().zip(twists).all(|(j, t)| (j.alpha - t).abs() < 1e-12);
        let zeros = [j[0].a, j[1].a, j[1].d, j[2].a, j[3].d, j[5].a, j[5].d];
        let centerd = zeros.iter().all(|&x| x == 0.0) && j.iter().all(|j| j.theta == 0.0);
        if !twisted || !centerd || (j[2].d == 0.0) || (j[4].d == 0.0) {
            return None;
        }
        let (d3, a4, a5, d5) = (j[2].d, j[3].a, j[4].a, j[4].d);
        Some(Inverse {
            d1: j[0].d,
            d3,
            a4,
            a5,
            d5,
            q4_offset: (-d3).atan2(-a4) - d5.atan2(a5),
            flange_seven: chain.flange.inverse(),
            chain: chain.clone(),
        })
    }

    /// `angle` plus whole turns, within the limits of a joint if possible.
    #[inline]
    fn within(&self, joint: usize, angle: f64) -> Option<f64> {
        let (low, high) = self.chain.joints[joint].limits;
        let mut angle = angle;
        while angle > high + SLACK {
            angle -= TAU;
        }
        while angle < low - SLACK {
            angle += TAU;
        }
        (angle <= high + SLACK).then(|| angle.clamp(low, high))
    }

    /// Adds to `found` the branches within limits that place the flange at `target` (in the base)
    /// with the last joint at `q7`. If the shoulder is straight, q1 is free.
    pub fn solve(&self, target: &Pose, q7: f64, found: &mut impl Branches) {
        let (low, high) = self.chain.joints[6].limits;
        if !(low..=high).contains(&q7) {
            return;
        }
        let six = target.then(&self.flange_seven).then(&self.chain.joints[6].pose(q7).inverse());
        let to_shoulder = DVec3::new(0.0, 0.0, self.d1) - six.position;
        let (r2, reach) = (to_shoulder.length_squared(), to_shoulder.length());
        let upper2 = self.a4 * self.a4 + self.d3 * self.d3;
        let fore2 = self.a5 * self.a5 + self.d5 * self.d5;
        let cosine = (upper2 + fore2 - r2) / (2.0 * (upper2 * fore2).sqrt());
        if cosine.abs() > 1.0 || reach == 0.0 {
            return;
        }
        let opening = cosine.acos();
        for q4 in [opening + self.q4_offset, -opening + self.q4_offset] {
            if let Some(q4) = self.within(3, q4) {
                self.solve_elbow(&six, to_shoulder / reach, [q4, q7], found);
            }
        }
    }

    /// Solves both directions of the forearm for one q4.
    fn solve_elbow(
        &self,
        six: &Pose,
        to_shoulder: DVec3,
        [q4, q7]: [f64; 2],
        found: &mut impl Branches,
    ) {
        // Shoulder from the wrist, in the elbow's frame, whose y axis is the forearm.
        if square(q4 - found.near()[3]) + square(q7 - found.near()[6]) >= found.bound2() {
            return;
        }
        let (s, c) = q4.sin_cos();
        let flat =
            DVec2::new(-c * self.a4 - s * self.d3 - self.a5, s * self.a4 - c * self.d3 - self.d5);
        let flat = flat.normalize_or_zero();
        if flat.x.abs() < PARALLEL {
            return; // the forearm points at the shoulder: a singular pose
        }
        let z6 = six.rotation.z_axis;
        let across = to_shoulder - z6 * to_shoulder.dot(z6);
        let sine = across.length();
        if sine < PARALLEL || flat.y.abs() > sine * (1.0 + ROUNDING) {
            return;
        }
        let e1 = across / sine;
        let e2 = z6.cross(e1);
        let along = (flat.y / sine).clamp(-1.0, 1.0);
        let aside = (1.0 - along * along).sqrt();
        for aside in [aside, -aside] {
            let z5 = along * e1 + aside * e2;
            let x4 = ((to_shoulder - flat.y * z5) / flat.x).normalize();
            let elbow = DMat3::from_cols(x4, z5, x4.cross(z5));
            self.solve_ends(six, &elbow, [q4, q7], found);
        }
    }

    /// Solves q5, q6 and both shoulders, given the elbow's frame.
    fn solve_ends(&self, six: &Pose, elbow: &DMat3, [q4, q7]: [f64; 2], found: &mut impl Branches) {
        let z6 = six.rotation.z_axis;
        let near = *found.near();
        let so_far = square(q4 - near[3]) + square(q7 - near[6]);
        let q5 = z6.dot(elbow.x_axis).atan2(z6.dot(elbow.z_axis));
        let Some(q5) = self.within(4, q5) else { return };
        let so_far = so_far + square(q5 - near[4]);
        if so_far >= found.bound2() {
            return;
        }
        let z5 = elbow.y_axis;
        let q6 = z5.dot(six.rotation.x_axis).atan2(z5.dot(six.rotation.y_axis));
        let Some(q6) = self.within(5, q6) else { return };
        if so_far + square(q6 - near[5]) >= found.bound2() {
            return;
        }
        // Frame of the upper arm: R_03 = R_04 (Rot_x(π/2) Rot_z(q4))ᵀ.
        let (s, c) = q4.sin_cos();
        let x3 = elbow.x_axis * c - elbow.y_axis * s;
        let z3 = elbow.x_axis * s + elbow.y_axis * c;
        let level = (z3.x * z3.x + z3.y * z3.y).sqrt();
        let tilt = level.atan2(z3.z);
        let turn = if level > PARALLEL { z3.y.atan2(z3.x) } else { near[0] };
        for (q1, q2) in [(turn, tilt), (turn + PI, -tilt)] {
            let (Some(q1), Some(q2)) = (self.within(0, q1), self.within(1, q2)) else { continue };
            let ((s1, c1), (s2, c2)) = (q1.sin_cos(), q2.sin_cos());
            // Rows of R_02ᵀ: its x axis and its z axis.
            let x2 = DVec3::new(c1 * c2, s1 * c2, -s2);
            let z2 = DVec3::new(-s1, c1, 0.0);
            if let Some(q3) = self.within(2, x3.dot(z2).atan2(x3.dot(x2))) {
                found.push([q1, q2, q3, q4, q5, q6, q7]);
            }
        }
    }

    /// Solution nearest to `near` (Euclidean in the joint angles) over all branches and all q7.
    ///
    /// The first search keeps q7 of `near`: a solution within `NEIGHBOR` of `near` ends it. The
    /// second is on a grid of q7, outwards from that of `near`, refined until a solution exists.
    /// Steps along the arm's self-motion refine the result.
    pub fn nearest(&self, target: &Pose, near: &Angles) -> Option<Angles> {
        let (low, high) = self.chain.joints[6].limits;
        let start = near[6].clamp(low, high);
        let mut search = Nearest::new(near, f64::INFINITY);
        self.solve(target, start, &mut search);
        if let Some(found) = search.found() {
            search.push(self.refine(target, found, near));
            if search.bound2 < square(NEIGHBOR) {
                return search.found();
            }
        }
        let mut count = SEARCH.0;
        loop {
            for k in 1..=count {
                let offset = (high - low) * square(k as f64 / count as f64);
                if square(offset) >= search.bound2 {
                    break;
                }
                self.solve(target, start + offset, &mut search);
                self.solve(target, start - offset, &mut search);
            }
            if search.found().is_some() || count >= SEARCH.1 {
                break;
            }
            count *= 4;
        }
        search.found().map(|best| self.refine(target, best, near))
    }

    /// Newton iterations of q7 along the self-motion towards the point nearest to `near`.
    fn refine(&self, target: &Pose, start: Angles, near: &Angles) -> Angles {
        let (low, high) = self.chain.joints[6].limits;
        let mut best = Nearest { near, best: start, bound2: distance2(&start, near) };
        let mut step = self.self_motion_step(&start, near);
        for _ in 0..REFINE {
            if step.abs() < 1e-9 {
                break;
            }
            let mut next = best;
            self.solve(target, (best.best[6] + step).clamp(low, high), &mut next);
            if next.bound2 < best.bound2 {
                let gain = best.bound2 - next.bound2;
                best = next;
                if gain < CONVERGED * best.bound2 {
                    break;
                }
                step = self.self_motion_step(&best.best, near);
            } else {
                step *= 0.25;
            }
        }
        best.best
    }

    /// Change of q7 to the point on the tangent of the self-motion that is nearest to `near`.
    fn self_motion_step(&self, at: &Angles, near: &Angles) -> f64 {
        let motion = self.self_motion(at);
        let square: f64 = motion.iter().map(|m| m * m).sum();
        let along: f64 = (0..JOINTS).map(|i| motion[i] * (near[i] - at[i])).sum();
        if square > 0.0 { motion[6] * along / square } else { 0.0 }
    }

    /// Joint velocities that keep the flange fixed: the null vector of the Jacobian.
    fn self_motion(&self, at: &Angles) -> Angles {
        let mut pose = Pose { rotation: DMat3::IDENTITY, position: DVec3::ZERO };
        let mut rows = [[0.0; JOINTS]; 6];
        for (column, joint) in self.chain.joints.iter().enumerate() {
            pose = pose.then(&joint.pose(at[column]));
            let axis = pose.rotation.z_axis;
            let moment = pose.position.cross(axis);
            for k in 0..3 {
                (rows[k][column], rows[3 + k][column]) = (axis[k], moment[k]);
            }
        }
        null_vector(rows)
    }
}

/// Null vector of six rows of seven numbers, by elimination with full pivoting.
fn null_vector(mut rows: [[f64; JOINTS]; 6]) -> Angles {
    let mut order: [usize; JOINTS] = std::array::from_fn(|i| i);
    for k in 0..6 {
        let (mut row, mut column, mut size) = (k, k, -1.0);
        for r in k..6 {
            for c in k..JOINTS {
                let entry = rows[r][order[c]].abs();
                if entry > size {
                    (row, column, size) = (r, c, entry);
                }
            }
        }
        if size < 1e-12 {
            return [0.0; JOINTS]; // singular: more than one self-motion
        }
        rows.swap(k, row);
        order.swap(k, column);
        let pivot = rows[k];
        for lower in rows.iter_mut().skip(k + 1) {
            let factor = lower[order[k]] / pivot[order[k]];
            (0..JOINTS).for_each(|c| lower[c] -= factor * pivot[c]);
        }
    }
    let mut vector = [0.0; JOINTS];
    vector[order[6]] = 1.0;
    for k in (0..6).rev() {
        let sum: f64 = (k + 1..JOINTS).map(|c| rows[k][order[c]] * vector[order[c]]).sum();
        vector[order[k]] = -sum / rows[k][order[k]];
    }
    vector
}
