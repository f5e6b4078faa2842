//! Contact between particles that are closer than their initial distance.

use super::particle::{BOUNCE, Kind, ParticleState};

/// Separates pairs of particles and lets them bounce; momentum is conserved.
///
/// Particles of a clump overlap: a pair touches at the sum of its radii, or at its initial distance
/// if that is less, so that particles at rest remain at rest. Pairs are processed in the order of
/// their x coordinates, and of their indices if these are equal; `moves` selects the particles that
/// take part.
pub fn push_apart(
    kinds: &[Kind],
    states: &mut [ParticleState],
    mass: impl Fn(&Kind) -> f64,
    moves: impl Fn(usize, &ParticleState) -> bool,
) {
    let takes_part = |&k: &usize| !kinds[k].is_bubble && !states[k].sits() && moves(k, &states[k]);
    let mut order: Vec<usize> = (0..states.len()).filter(takes_part).collect();
    order.sort_by(|&a, &b| states[a].position.x.total_cmp(&states[b].position.x).then(a.cmp(&b)));
    let widest = order.iter().map(|&k| kinds[k].radius).fold(0.0, f64::max);
    let begins: Vec<f64> = order.iter().map(|&k| states[k].position.x).collect();
    for (i, &a) in order.iter().enumerate() {
        let reach = begins[i] + kinds[a].radius + widest;
        for (&b, _) in order[i + 1..].iter().zip(&begins[i + 1..]).take_while(|(_, x)| **x < reach)
        {
            let offset = states[a].position - states[b].position;
            let touch =
                (kinds[a].radius + kinds[b].radius).min(kinds[a].home.distance(kinds[b].home));
            let apart = offset.length();
            if apart >= touch || apart == 0.0 {
                continue;
            }
            let (normal, [one, two]) = (offset / apart, [a, b].map(|k| 1.0 / mass(&kinds[k])));
            let part = (touch - apart) / (one + two) * normal;
            let approach = (states[a].velocity - states[b].velocity).dot(normal).min(0.0);
            let impulse = -(1.0 + BOUNCE) * approach / (one + two) * normal;
            states[a].position += one * part;
            states[b].position -= two * part;
            states[a].velocity += one * impulse;
            states[b].velocity -= two * impulse;
        }
    }
}
