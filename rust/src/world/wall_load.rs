//! Loads of a capsule on its wall, by vertex.

use super::body::{Body, Motion};
use super::contact_patch::{FacetLoad, Samples};
use super::coupling_state::ContactFace;
use super::soft_wall::SoftWall;
use super::solve::{Symmetric6, Twist};
use super::substep::Reaction;
use crate::simd::f64x8::LANES;
use glam::{DMat3, DVec3};

/// Regularization of a system that could be singular, relative to its size.
const SINGULAR: f64 = 1e-9;

/// Substep, as input of the coupling.
pub struct Stride<'a> {
    pub body: &'a Body,
    pub before: &'a Motion,
    pub after: &'a Motion,
    pub reaction: &'a Reaction,
    /// Coefficient of friction.
    pub friction: f64,
    pub dt: f64,
}

/// Forces on near vertices, normal ones and friction; writes those of each triangle to `touched`.
pub fn forces(soft: &mut SoftWall, stride: &Stride, touched: &mut Vec<ContactFace>) -> Vec<DVec3> {
    let (before, after, dt) = (stride.before, stride.after, stride.dt);
    let change = Twist {
        linear: after.velocity - before.velocity,
        angular: after.angular_velocity - before.angular_velocity,
    };
    let change = change.to_array();
    let twist = Twist { linear: after.velocity, angular: after.angular_velocity };
    let mut normals = vec![(0.0, DVec3::ZERO); soft.near.corners.len()];
    for (places, s) in soft.patch.lanes() {
        for i in 0..LANES {
            let (force, [x, y, z, ..]) = (push(s, i, &change, dt), &s.lever);
            let sum = &mut normals[places[i] as usize];
            sum.0 += force;
            sum.1 += force * DVec3::new(x[i], y[i], z[i]);
        }
    }
    let mut forces = vec![DVec3::ZERO; soft.near.vertices.len()];
    touched.clear();
    for on_facet in &soft.patch.facet_loads {
        let (normal, force) = normals[on_facet.place as usize];
        let tangent = on_facet.friction_on_wall(stride.friction, before.position, &twist);
        let normal = f64::max(normal, 0.0);
        let face = soft.near.faces[on_facet.place as usize];
        touched.push(ContactFace { face, normal, tangent });
        for (v, share) in shares(soft, on_facet) {
            forces[v] += share * (force + tangent);
        }
    }
    spread_rest(soft, stride, &mut forces);
    forces
}

/// Force of a sample over a substep in which the capsule's twist changes, as in `step` [N].
fn push(s: &Samples, i: usize, change: &[f64; 6], dt: f64) -> f64 {
    let push = s.load[i] + 0.5 * dt * s.stiffness[i] * s.speed[i];
    if push <= 0.0 {
        return 0.0;
    }
    let more: f64 = s.lever.iter().zip(change).map(|(j, d)| j[i] * d).sum();
    push + (0.25 * dt * s.stiffness[i] + 0.5 * s.damping[i]) * more
}

/// Corners of a triangle in contact, and barycentric coordinates of its center of pressure.
pub fn shares(soft: &SoftWall, on_facet: &FacetLoad) -> impl Iterator<Item = (usize, f64)> {
    let corners = soft.near.corners[on_facet.place as usize].map(|v| v as usize);
    let [a, b, c] = corners.map(|v| soft.vertex(soft.near.vertices[v]).0);
    let normal = (b - a).cross(c - a);
    let part = |q: DVec3, r: DVec3| {
        (q - on_facet.center).cross(r - on_facet.center).dot(normal) / normal.length_squared()
    };
    corners.into_iter().zip([part(b, c), part(c, a), part(a, b)])
}

/// Spreads over the corners in contact the difference between the triangles' forces and the
/// negative wrench of the wall on the capsule (drag on the body, and the residual of the last
/// friction iteration), as a rigid pattern: force and torque are thus exactly opposite.
fn spread_rest(soft: &SoftWall, stride: &Stride, forces: &mut [DVec3]) {
    let mut weights = vec![0.0; forces.len()];
    let load: f64 = soft.patch.facet_loads.iter().map(|on_facet| on_facet.load).sum();
    if load <= 0.0 {
        return;
    }
    for on_facet in &soft.patch.facet_loads {
        for v in soft.near.corners[on_facet.place as usize] {
            weights[v as usize] += on_facet.load / (3.0 * load);
        }
    }
    let (wrench, size) = (stride.reaction.wrench, stride.body.radius);
    let mut rest = Twist { linear: -wrench.linear, angular: -wrench.angular / size };
    let (mut first, mut second) = (DVec3::ZERO, DMat3::ZERO);
    let arm = |v: usize| (soft.vertex(soft.near.vertices[v]).0 - stride.before.position) / size;
    let loaded = || weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0);
    for (v, weight) in loaded() {
        let r = arm(v);
        rest.linear -= forces[v];
        rest.angular -= r.cross(forces[v]);
        first += *weight * r;
        second += DMat3::from_cols(r * r.x, r * r.y, r * r.z) * *weight;
    }
    let pattern = Twist::from_array(rigid_pattern(first, second).solve(rest.to_array()));
    for (v, weight) in loaded() {
        forces[v] += *weight * (pattern.linear + pattern.angular.cross(arm(v)));
    }
}

/// Matrix from forces `a + ω × r` by weights to their resultant, for first and second moments of r.
fn rigid_pattern(first: DVec3, second: DMat3) -> Symmetric6 {
    let mut matrix = Symmetric6::default();
    let trace = second.x_axis.x + second.y_axis.y + second.z_axis.z;
    let turning = DMat3::from_diagonal(DVec3::splat(trace)) - second;
    for (column, axis) in DVec3::AXES.into_iter().enumerate() {
        let moment = first.cross(axis);
        for row in 0..3 {
            matrix.0[3 + row][column] = moment[row];
            if column <= row {
                matrix.0[3 + row][3 + column] = turning.col(column)[row];
            }
        }
        matrix.0[column][column] = 1.0 + SINGULAR;
        matrix.0[3 + column][3 + column] += SINGULAR;
    }
    matrix
}
