//! Collision of an arm with itself and with a table; each link is a set of capsules.

use super::kinematic_chain::Pose;
use glam::DVec3;

/// Line segment with a radius, fixed to a frame of the arm.
#[derive(Clone, Copy, Debug)]
pub struct LinkCapsule {
    /// Frame: 0 is the base, then the joints, last the flange.
    pub frame: usize,
    /// Ends in that frame [m].
    pub ends: [DVec3; 2],
    /// Radius [m].
    pub radius: f64,
}

/// Capsules of an arm, pairs to compare, and the table.
#[derive(Clone, Debug, Default)]
pub struct Obstacles {
    /// Capsules of all links.
    pub capsules: Vec<LinkCapsule>,
    /// Indices of pairs of capsules that must not collide.
    pub pairs: Vec<(usize, usize)>,
    /// Table: a point on it and its outward unit normal, in the base, or `None`.
    pub table: Option<(DVec3, DVec3)>,
}

/// Squared distance between two segments (Ericson 2004, Real-Time Collision Detection, 5.1.9).
fn segment_distance2([p1, q1]: [DVec3; 2], [p2, q2]: [DVec3; 2]) -> f64 {
    let (d1, d2, r) = (q1 - p1, q2 - p2, p1 - p2);
    let (a, e, f) = (d1.length_squared(), d2.length_squared(), d2.dot(r));
    let (b, c) = (d1.dot(d2), d1.dot(r));
    let part = |x: f64, y: f64| if y > 0.0 { (x / y).clamp(0.0, 1.0) } else { 0.0 };
    let mut s = part(b * f - c * e, a * e - b * b);
    let mut t = if e > 0.0 { (b * s + f) / e } else { 0.0 };
    if !(0.0..=1.0).contains(&t) || a * e - b * b <= 0.0 {
        t = t.clamp(0.0, 1.0);
        s = part(b * t - c, a);
        t = part(b * s + f, e);
        s = part(b * t - c, a);
    }
    (r + d1 * s - d2 * t).length_squared()
}

impl Obstacles {
    /// Minimum distance [m] between the links of a pair, and of a link to the table; negative if
    /// they intersect. Links on the base are not compared with the table.
    pub fn clearance(&self, frames: &[Pose]) -> (f64, f64) {
        let placed = |capsule: &LinkCapsule| {
            if capsule.frame == 0 {
                return capsule.ends;
            }
            let pose = &frames[capsule.frame - 1];
            capsule.ends.map(|p| pose.rotation * p + pose.position)
        };
        let own = self.pairs.iter().map(|&(i, j)| {
            let (one, other) = (&self.capsules[i], &self.capsules[j]);
            segment_distance2(placed(one), placed(other)).sqrt() - one.radius - other.radius
        });
        let own = own.fold(f64::INFINITY, f64::min);
        let Some((point, normal)) = self.table else { return (own, f64::INFINITY) };
        let moving = self.capsules.iter().filter(|capsule| capsule.frame > 1);
        let heights = moving.flat_map(|capsule| {
            placed(capsule).map(|end| (end - point).dot(normal) - capsule.radius)
        });
        (own, heights.fold(f64::INFINITY, f64::min))
    }
}
