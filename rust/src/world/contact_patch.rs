//! Contact patch: pieces of triangles in SIMD lanes, summed in a fixed order.

use super::body::{Axis, Motion};
use crate::simd::f64x8::{LANES, Lane, Lane3, at, max, min, sum};
use crate::tissue::winkler_foundation::WinklerFoundation;
use glam::DVec3;

/// Cosine between the normals of wall and capsule below which the contact area fades to zero.
const GRAZING: f64 = 0.2;

/// Capsule as an indenter.
#[derive(Clone, Copy)]
pub struct Pressing {
    /// Stiffness of the wall.
    pub foundation: WinklerFoundation,
    /// Radius of the capsule [m].
    pub radius: f64,
    /// Axis of the capsule.
    pub axis: Axis,
    /// Motion of the capsule.
    pub motion: Motion,
}

/// Eight small triangles of the wall.
#[derive(Clone)]
pub struct Pieces {
    /// Corners [m].
    pub corners: [Lane3; 3],
    /// Area [m²]; 0 in an unused lane.
    pub area: Lane,
    /// Normal of the wall, into the lumen.
    pub normal: Lane3,
    /// Velocity of the wall [m/s].
    pub velocity: Lane3,
    /// Index among the patch's triangles.
    triangle: [u32; LANES],
    /// Index of the triangle among the near ones.
    place: [u32; LANES],
}

/// Loads of eight pieces.
#[derive(Clone)]
pub struct Samples {
    /// Normal of the capsule and its moment about the center of mass: Jacobian from twist to speed.
    pub lever: [Lane; 6],
    /// Speed of indentation [m/s].
    pub speed: Lane,
    /// Force along the normal [N].
    pub load: Lane,
    /// Derivative of the load by depth [N/m].
    pub stiffness: Lane,
    /// Derivative of the load by speed [N·s/m].
    pub damping: Lane,
    /// Center of pressure [m].
    center: Lane3,
    /// Stored energy [J].
    energy: Lane,
    /// Contact area [m²].
    area: Lane,
    /// Maximum depth [m].
    depth: Lane,
}

const NOTHING: Lane = [0.0; LANES];
const NO_PIECES: Pieces = Pieces {
    corners: [[NOTHING; 3]; 3],
    area: NOTHING,
    normal: [NOTHING; 3],
    velocity: [NOTHING; 3],
    triangle: [0; LANES],
    place: [0; LANES],
};
const NO_SAMPLES: Samples = Samples {
    lever: [NOTHING; 6],
    speed: NOTHING,
    load: NOTHING,
    stiffness: NOTHING,
    damping: NOTHING,
    center: [NOTHING; 3],
    energy: NOTHING,
    area: NOTHING,
    depth: NOTHING,
};

/// Load of one triangle of the wall.
#[derive(Clone, Copy, Default)]
pub struct FacetLoad {
    /// Index among the near triangles.
    pub place: u32,
    /// Center of pressure [m].
    pub center: DVec3,
    /// Unit normal of the capsule there.
    pub normal: DVec3,
    /// Normal force [N].
    pub load: f64,
    /// Velocity of the wall there [m/s].
    pub velocity: DVec3,
    /// Change of the wall's speed there per change of force within a substep [m/s per N]; 0 for a
    /// wall without a layer.
    pub mobility: f64,
}

/// Contact patch at one instant.
#[derive(Default)]
pub struct Patch {
    pieces: Vec<Pieces>,
    num_pieces: usize,
    /// Loads of the pieces.
    pub samples: Vec<Samples>,
    /// Triangles in contact.
    pub facet_loads: Vec<FacetLoad>,
    /// Stored energy [J].
    pub energy: f64,
    /// Contact area [m²].
    pub area: f64,
    /// Maximum depth [m].
    pub depth: f64,
}

impl Patch {
    /// Clears the patch; keeps its memory.
    pub fn clear(&mut self) {
        self.num_pieces = 0;
        self.pieces.clear();
        self.samples.clear();
        self.facet_loads.clear();
        (self.energy, self.area, self.depth) = (0.0, 0.0, 0.0);
    }

    /// Stored energy [J], contact area [m²] and maximum depth [m].
    pub fn extent(&self) -> [f64; 3] {
        [self.energy, self.area, self.depth]
    }

    /// Lane for one more piece, of the near triangle with index `place`.
    pub fn piece(&mut self, place: u32) -> (&mut Pieces, usize) {
        let lane = self.num_pieces % LANES;
        if lane == 0 {
            self.pieces.push(NO_PIECES);
        }
        if self.facet_loads.last().is_none_or(|on_facet| on_facet.place != place) {
            self.facet_loads.push(FacetLoad { place, ..FacetLoad::default() });
        }
        self.num_pieces += 1;
        let pieces = self.pieces.last_mut().expect("just pushed");
        pieces.triangle[lane] = self.facet_loads.len() as u32 - 1;
        pieces.place[lane] = place;
        (pieces, lane)
    }

    /// Loads of the pieces, with the indices of their triangles among the near ones; unused lanes
    /// are zero.
    pub fn lanes(&mut self) -> impl Iterator<Item = (&[u32; LANES], &mut Samples)> {
        self.pieces.iter().map(|pieces| &pieces.place).zip(&mut self.samples)
    }

    /// Result of `lanes` together with the triangles in contact.
    pub fn lanes_and_loads(
        &mut self,
    ) -> (impl Iterator<Item = (&[u32; LANES], &Samples)>, &mut [FacetLoad]) {
        let lanes = self.pieces.iter().map(|pieces| &pieces.place).zip(&self.samples);
        (lanes, &mut self.facet_loads)
    }

    /// Computes the loads of all pieces.
    pub fn press(&mut self, pressing: &Pressing) {
        press_all(pressing, &self.pieces, &mut self.samples);
        for (pieces, samples) in self.pieces.iter().zip(&self.samples) {
            self.energy += sum(&samples.energy);
            self.area += sum(&samples.area);
            self.depth = samples.depth.iter().fold(self.depth, |a, &b| a.max(b));
            for i in 0..LANES {
                let load = samples.load[i];
                if load > 0.0 {
                    let [x, y, z, ..] = samples.lever;
                    let on_facet = &mut self.facet_loads[pieces.triangle[i] as usize];
                    on_facet.load += load;
                    on_facet.center += load * at(&samples.center, i);
                    on_facet.normal += load * DVec3::new(x[i], y[i], z[i]);
                    on_facet.velocity = at(&pieces.velocity, i);
                }
            }
        }
        self.facet_loads.retain(|on_facet| on_facet.load > 0.0);
        for on_facet in &mut self.facet_loads {
            on_facet.center /= on_facet.load;
            on_facet.normal = on_facet.normal.normalize_or_zero();
        }
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn press_all(pressing: &Pressing, pieces: &[Pieces], samples: &mut Vec<Samples>) {
    for eight in pieces {
        samples.push(press_eight(*pressing, eight));
    }
}

/// Separate function, so that the compiler knows that input and output do not alias.
#[inline(always)]
fn press_eight(pressing: Pressing, pieces: &Pieces) -> Samples {
    let mut samples = NO_SAMPLES;
    for i in 0..LANES {
        press_one(&pressing, pieces, &mut samples, i);
    }
    samples
}

/// Part of a triangle with positive depth, linear in it: integrals divided by the triangle's area.
#[derive(Clone, Copy)]
struct Part {
    /// Integrals of 1, of the depth and of its square.
    moments: [f64; 3],
    /// Integrals of the depth times each barycentric coordinate.
    shares: [f64; 3],
}

/// Integrates over a triangle with depths a, b, c at its corners.
#[inline(always)]
fn cut(a: f64, b: f64, c: f64) -> Part {
    // Corner that is alone on its side of the cut, if any; its depth is q.
    let (in_a, in_b, in_c) = (a > 0.0, b > 0.0, c > 0.0);
    let is_a = (in_a != in_b) & (in_a != in_c);
    let is_b = (in_b != in_a) & (in_b != in_c);
    let is_c = (in_c != in_a) & (in_c != in_b);
    let q = select(is_a, a, select(is_b, b, c));
    // Distance of the cut from it towards each other corner, relative to the edge; 1 for itself.
    let (fa, fb, fc) = (crossing(q, a), crossing(q, b), crossing(q, c));
    let corner = fa * fb * fc;
    let rest = 5.0 - fa - fb - fc;
    let most = (in_a & in_b) | (in_b & in_c) | (in_c & in_a);
    let whole = select(most, 1.0, 0.0);
    let sign = select(is_a | is_b | is_c, 1.0 - 2.0 * whole, 0.0) * corner;
    let total = a + b + c;
    let squares = a * a + b * b + c * c + a * b + b * c + c * a;
    let (twelfth, signed) = (whole * (1.0 / 12.0), sign * q * (1.0 / 12.0));
    Part {
        moments: [
            whole + sign,
            (whole * total + sign * q) * (1.0 / 3.0),
            (whole * squares + sign * q * q) * (1.0 / 6.0),
        ],
        shares: [
            twelfth * (total + a) + signed * select(is_a, rest, fa),
            twelfth * (total + b) + signed * select(is_b, rest, fb),
            twelfth * (total + c) + signed * select(is_c, rest, fc),
        ],
    }
}

/// Position of depth 0 between depths q and r, as a fraction from q; 1 if they are equal.
#[inline(always)]
fn crossing(q: f64, r: f64) -> f64 {
    let way = q - r;
    select(way == 0.0, 1.0, q / select(way == 0.0, 1.0, way))
}

#[inline(always)]
fn select(condition: bool, yes: f64, no: f64) -> f64 {
    if condition { yes } else { no }
}

type Three = [f64; 3];

#[inline(always)]
fn dot(a: Three, b: Three) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: Three, b: Three) -> Three {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
fn sub(a: Three, b: Three) -> Three {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn scale(a: Three, s: f64) -> Three {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// Weighted sum of three vectors.
#[inline(always)]
fn blend(weights: Three, a: Three, b: Three, c: Three) -> Three {
    let [u, v, w] = weights;
    [u * a[0] + v * b[0] + w * c[0], u * a[1] + v * b[1] + w * c[1], u * a[2] + v * b[2] + w * c[2]]
}

#[inline(always)]
fn lane(v: &Lane3, i: usize) -> Three {
    [v[0][i], v[1][i], v[2][i]]
}

/// Computes the load of the piece in lane `i`.
///
/// Depth is linear between the corners, raised so that its mean over the piece is correct to second
/// order (¾ of the value at the centroid and 1/12 of that at each corner). Pressure acts at the
/// centroid of the depth.
#[inline(always)]
fn press_one(pressing: &Pressing, pieces: &Pieces, out: &mut Samples, i: usize) {
    let (axis, radius) = (&pressing.axis, pressing.radius);
    let [a, b, c] = &pieces.corners;
    let (a, b, c) = (lane(a, i), lane(b, i), lane(c, i));
    let (oa, ob, oc) = (axis.offset(a), axis.offset(b), axis.offset(c));
    let third = 1.0 / 3.0;
    let middle = axis.offset(blend([third; 3], a, b, c));
    let (ua, ub, uc) = (radius - length(oa), radius - length(ob), radius - length(oc));
    let at_middle = radius - length(middle);
    let raise = 0.75 * at_middle - 0.25 * (ua + ub + uc);
    let part = cut(ua + raise, ub + raise, uc + raise);
    let [covered, depths, squares] = part.moments;
    let touches = (depths > 0.0) & (covered > 0.0);
    let (by_area, by_depth) =
        (1.0 / select(touches, covered, 1.0), 1.0 / select(touches, depths, 1.0));
    let mean = depths * by_area;
    let spread = max(squares * by_area - mean * mean, 0.0);
    let weights = scale(part.shares, by_depth);
    let (center, toward) = (blend(weights, a, b, c), blend(weights, oa, ob, oc));
    let normal = scale(toward, 1.0 / max(length(toward), 1e-300));
    let facing = -dot(normal, lane(&pieces.normal, i));
    let m = pressing.motion;
    let lag = sub(m.velocity.to_array(), lane(&pieces.velocity, i));
    let moment = cross(sub(center, m.position.to_array()), normal);
    let speed = dot(normal, lag) + dot(moment, m.angular_velocity.to_array());
    let area = pieces.area[i] * covered * min(max(facing * (1.0 / GRAZING), 0.0), 1.0);
    let area = select(touches, area, 0.0);
    let pressure = pressing.foundation.pressure(select(touches, mean, 0.0), spread, speed);
    for d in 0..3 {
        out.lever[d][i] = normal[d];
        out.lever[3 + d][i] = moment[d];
        out.center[d][i] = center[d];
    }
    out.speed[i] = speed;
    out.load[i] = pressure.value * area;
    out.stiffness[i] = pressure.by_depth * area;
    out.damping[i] = pressure.by_speed * area;
    out.energy[i] = pressure.energy * area;
    out.area[i] = area;
    out.depth[i] = select(area > 0.0, max(max(ua, ub), max(uc, at_middle)), 0.0);
}

#[inline(always)]
fn length(a: Three) -> f64 {
    dot(a, a).sqrt()
}
