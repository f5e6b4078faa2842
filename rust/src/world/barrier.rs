//! Barrier about the capsule's axis that the wall cannot cross.
//!
//! Pressure over an area keeps the capsule off a wall, but the crest of a fold has almost no area:
//! it would cut in as far as the axis, and the wall's springs would then push to the wrong side. A
//! triangle nearer to the axis than a fraction of the radius is therefore an inelastic contact:
//! impulses between the closest points of axis and triangle remove the speed of approach.

use super::body::{Axis, Body, Motion};
use super::contact::Facet;
use super::contact_patch::FacetLoad;
use super::solve::{Symmetric6, Twist, dot};
use glam::DVec3;

/// Radius of the barrier, as a fraction of the capsule's.
const SHARE: f64 = 0.2;
/// Time in which a penetration of the barrier is corrected, or the substep if that is longer [s].
const RECOVERY: f64 = 5e-3;
/// Compliance of an impulse, as a fraction of the capsule's own: limits impulses where walls on
/// both sides leave too little room.
const GIVE: f64 = 0.2;
/// Number of Gauss-Seidel sweeps over all impulses.
const SWEEPS: usize = 16;
/// Distance below which it does not determine a direction [m].
const TOUCHING: f64 = 1e-9;

/// Triangle within the barrier.
struct Block {
    place: u32,
    /// Point of the triangle closest to the axis [m].
    center: DVec3,
    /// Unit vector from the axis to `center`.
    normal: DVec3,
    /// Velocity of the triangle [m/s].
    velocity: DVec3,
    /// Jacobian from twist to speed of approach.
    lever: [f64; 6],
    /// Change of twist by an impulse of 1 N·s.
    answer: [f64; 6],
    /// Speed of approach to be removed [m/s].
    excess: f64,
    /// Impulse [N·s].
    impulse: f64,
}

/// Keeps the triangles out of the barrier: adds the impulses to the `change` of twist of a substep
/// of `dt`, which `matrix` resists, and their loads to `facet_loads`.
pub fn keep_out(
    (body, motion): (&Body, &Motion),
    facets: &[Facet],
    matrix: &Symmetric6,
    change: Twist,
    facet_loads: &mut Vec<FacetLoad>,
    dt: f64,
) -> Twist {
    let radius = SHARE * body.radius;
    let close = facets.iter().filter(|facet| facet.distance - facet.reach < radius);
    let axis = body.axis(motion);
    let recovery = RECOVERY.max(dt);
    let mut blocks: Vec<Block> =
        close.filter_map(|facet| block(facet, &axis, motion.position, radius, recovery)).collect();
    if blocks.is_empty() {
        return change;
    }
    let after = Twist {
        linear: motion.velocity + change.linear,
        angular: motion.angular_velocity + change.angular,
    };
    for block in &mut blocks {
        block.answer = matrix.solve(block.lever);
        block.excess += dot(&block.lever, &after.to_array()) - block.normal.dot(block.velocity);
    }
    let more = settle(&mut blocks);
    facet_loads.extend(
        blocks.iter().filter(|block| block.impulse > 0.0).map(|block| block.facet_load(dt)),
    );
    Twist { linear: change.linear + more.linear, angular: change.angular + more.angular }
}

impl Block {
    /// Load of the triangle over a substep of `dt`.
    fn facet_load(&self, dt: f64) -> FacetLoad {
        FacetLoad {
            place: self.place,
            center: self.center,
            normal: self.normal,
            load: self.impulse / dt,
            velocity: self.velocity,
            mobility: 0.0,
        }
    }
}

/// Contact of a triangle with the barrier, or `None` if it is outside.
fn block(facet: &Facet, axis: &Axis, position: DVec3, radius: f64, recovery: f64) -> Option<Block> {
    let (on_axis, center) = closest(axis, facet.corners);
    let distance = (center - on_axis).length();
    if distance >= radius {
        return None;
    }
    let [a, b, c] = facet.corners;
    let normal = if distance > TOUCHING {
        (center - on_axis) / distance
    } else {
        -(b - a).cross(c - a).normalize_or_zero()
    };
    let moment = (on_axis - position).cross(normal);
    Some(Block {
        place: facet.place,
        center,
        normal,
        velocity: facet.velocity,
        lever: Twist { linear: normal, angular: moment }.to_array(),
        answer: [0.0; 6],
        excess: (radius - distance) / recovery,
        impulse: 0.0,
    })
}

/// Solves for nonnegative impulses that remove the excess; returns the change of twist.
fn settle(blocks: &mut [Block]) -> Twist {
    let mut change = [0.0; 6];
    for _ in 0..SWEEPS {
        for block in blocks.iter_mut() {
            let own = dot(&block.lever, &block.answer);
            let left = block.excess + dot(&block.lever, &change) - GIVE * own * block.impulse;
            let impulse = (block.impulse + left / ((1.0 + GIVE) * own)).max(0.0);
            let more = impulse - block.impulse;
            change.iter_mut().zip(&block.answer).for_each(|(x, answer)| *x -= more * answer);
            block.impulse = impulse;
        }
    }
    Twist::from_array(change)
}

/// Closest points of the axis and of a triangle.
fn closest(axis: &Axis, corners: [DVec3; 3]) -> (DVec3, DVec3) {
    let [a, b, c] = corners;
    if let Some(through) = crossing(axis, corners) {
        return (through, through);
    }
    let ends = [axis.start, axis.start + axis.span].map(|end| (end, on_face(corners, end)));
    let edges = [(a, b), (b, c), (c, a)].map(|(from, to)| between(axis, from, to - from));
    let pairs = ends.into_iter().filter_map(|(end, on)| on.map(|on| (end, on))).chain(edges);
    let square = |pair: &(DVec3, DVec3)| (pair.1 - pair.0).length_squared();
    pairs.min_by(|p, q| square(p).total_cmp(&square(q))).expect("three edges")
}

/// Intersection of the axis with a triangle, if any.
fn crossing(axis: &Axis, corners: [DVec3; 3]) -> Option<DVec3> {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let (from, rate) = (normal.dot(a - axis.start), normal.dot(axis.span));
    let along = from / rate;
    if !(0.0..=1.0).contains(&along) {
        return None;
    }
    let through = axis.start + along * axis.span;
    on_face(corners, through).map(|_| through)
}

/// Orthogonal projection of `p` on a triangle, if it lies within the face.
fn on_face([a, b, c]: [DVec3; 3], p: DVec3) -> Option<DVec3> {
    let normal = (b - a).cross(c - a);
    let side = |from: DVec3, to: DVec3| normal.dot((to - from).cross(p - from)) >= 0.0;
    let inside = side(a, b) && side(b, c) && side(c, a) && normal != DVec3::ZERO;
    inside.then(|| p - normal * (normal.dot(p - a) / normal.length_squared()))
}

/// Closest points of the axis and of an edge (Ericson 2004, Real-Time Collision Detection, 5.1.9):
/// first on the infinite line of the axis, then on each segment from the point on the other.
fn between(axis: &Axis, from: DVec3, edge: DVec3) -> (DVec3, DVec3) {
    let (way, length) = (axis.start - from, edge.length_squared());
    let (across, along) = (axis.span.dot(edge), axis.span.length_squared());
    let apart = along * length - across * across;
    let s = if apart > 1e-12 * along * length {
        ((across * edge.dot(way) - axis.span.dot(way) * length) / apart).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let t = ((edge.dot(way) + s * across) / length.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    let on_edge = from + t * edge;
    let on_axis = axis.nearest(on_edge);
    (on_axis, on_edge)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers() -> impl FnMut() -> DVec3 {
        let mut state = 1u64;
        let mut next = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        move || DVec3::new(next(), next(), next())
    }

    /// Compares with the minimum distance over a fine grid of points of both.
    #[test]
    fn closest_points_of_axis_and_triangle() {
        let mut point = numbers();
        for _ in 0..200 {
            let (start, span) = (point(), 1.5 * point());
            let axis = Axis::new(start, span);
            let corners @ [a, b, c] = [point(), point(), point()];
            let (on_axis, on_triangle) = closest(&axis, corners);
            let found = (on_axis - on_triangle).length();
            let mut least = f64::INFINITY;
            for i in 0..=60 {
                for j in 0..=60 - i {
                    let p = a + (b - a) * (f64::from(i) / 60.0) + (c - a) * (f64::from(j) / 60.0);
                    least = least.min((p - axis.nearest(p)).length());
                }
            }
            assert!(found <= least + 1e-12 && least <= found + 0.03, "{found} {least}");
            assert!((axis.nearest(on_axis) - on_axis).length() < 1e-12);
        }
    }
}
