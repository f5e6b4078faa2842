//! Packet tracing: rays from one point through a tile of pixels.
//!
//! The rays of a tile share their origin, so they lie in a pyramid. A node of the hierarchy is
//! tested against the pyramid's four sides, all eight children at once, at the same cost for 64
//! rays as for one. Triangles are tested against each ray with the edge functions of Plücker
//! coordinates, which are watertight: rounding cannot open a gap between neighbors.

use crate::simd::f32x64::*;
use crate::wall::bvh::{Bvh, Child, Node, STACK, Triangle, WIDTH};
use crate::wall::sides::Sides;
use std::ops::Range;

/// Maximum distance of rays [m].
pub const MAX_DISTANCE: f32 = 1e4;

/// Unit directions of a tile's rays and the pyramid around them.
#[derive(Clone)]
pub struct Pyramid {
    /// Unit direction of each ray.
    pub directions: Lane3,
    /// Inward normals of the four sides.
    pub sides: [Vec3; 4],
    /// Unit axis; no ray is more than 90° from it where `closed`.
    pub axis: Vec3,
    /// False if the rays spread too far for a pyramid: then only distance culls nodes.
    pub closed: bool,
}

/// Hits of the rays of a tile.
#[derive(Clone)]
pub struct Hits {
    /// Distance along each ray [m]; initially the maximum distance.
    pub distance: Lane,
    /// Triangle in leaf order, or `MISS`.
    pub triangle: [u32; LANES],
    /// Edge functions opposite the first and second corner, and the sum of all three, which is
    /// positive if the ray leaves through the back of the triangle.
    pub edges: Lane3,
}

/// `Hits::triangle` of a ray that hits nothing.
pub const MISS: u32 = u32::MAX;

impl Hits {
    /// No hits yet, for rays of the given `reach` (0 or less: not traced).
    #[inline(always)]
    pub fn within(reach: Lane) -> Self {
        Hits { distance: reach, triangle: [MISS; LANES], edges: [[0.0; LANES]; 3] }
    }
}

impl Pyramid {
    /// An empty pyramid without bounds.
    #[inline(always)]
    pub fn open() -> Self {
        let directions = [[0.0; LANES]; 3];
        Pyramid { directions, sides: [[0.0; 3]; 4], axis: [0.0; 3], closed: false }
    }

    /// The pyramid around unit `directions`; lanes where `used` is false are ignored.
    #[inline(always)]
    pub fn around(directions: Lane3, used: &[bool; LANES]) -> Self {
        let mut sum = [0.0f32; 3];
        for i in 0..LANES {
            if used[i] {
                sum = add(sum, at(&directions, i));
            }
        }
        let axis = normalize(sum);
        let least = if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let right = normalize(cross(axis, least));
        let down = cross(axis, right);
        let (mut low, mut high, mut nearest) = ([f32::MAX; 2], [f32::MIN; 2], f32::MAX);
        for i in 0..LANES {
            if used[i] {
                let d = at(&directions, i);
                let forward = dot(d, axis);
                nearest = min(nearest, forward);
                let slopes = [dot(d, right) / forward, dot(d, down) / forward];
                for k in 0..2 {
                    low[k] = min(low[k], slopes[k]);
                    high[k] = max(high[k], slopes[k]);
                }
            }
        }
        let side = |across: Vec3, slope: f32, sign: f32| {
            normalize(scale(sub(across, scale(axis, slope)), sign))
        };
        let sides = [
            side(right, low[0], 1.0),
            side(right, high[0], -1.0),
            side(down, low[1], 1.0),
            side(down, high[1], -1.0),
        ];
        Pyramid { directions, sides, axis, closed: nearest > 0.05 }
    }

    /// The same pyramid mirrored in a level surface.
    #[inline(always)]
    pub fn mirrored(&self) -> Self {
        let turn = |[x, y, z]: Vec3| [x, y, -z];
        let mut mirrored = self.clone();
        for z in &mut mirrored.directions[2] {
            *z = -*z;
        }
        mirrored.sides = self.sides.map(turn);
        mirrored.axis = turn(self.axis);
        mirrored
    }

    /// The same pyramid after a rotation given by its rows.
    #[inline(always)]
    pub fn rotated(&self, rows: &[Vec3; 3]) -> Self {
        let turn = |v: Vec3| [dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)];
        let mut directions = [[0.0; LANES]; 3];
        for (out, row) in directions.iter_mut().zip(rows) {
            for i in 0..LANES {
                out[i] = dot(*row, at(&self.directions, i));
            }
        }
        Pyramid {
            directions,
            sides: self.sides.map(turn),
            axis: turn(self.axis),
            closed: self.closed,
        }
    }
}

/// A plane through the origin of the rays, prepared for tests against boxes.
pub struct Plane {
    pub(super) normal: Vec3,
    /// Rows of `Node::bounds` that hold the box corner farthest along the normal.
    rows: [usize; 3],
    /// Value of the plane at the origin, minus a margin for rounding.
    pub(super) offset: f32,
}

impl Plane {
    /// A plane through `origin`, moved outwards by a margin [m].
    #[inline(always)]
    pub fn new(normal: Vec3, origin: Vec3, margin: f32, far_corner: bool) -> Self {
        let row = |axis: usize| axis + if (normal[axis] > 0.0) == far_corner { 3 } else { 0 };
        Plane { normal, rows: [row(0), row(1), row(2)], offset: dot(normal, origin) - margin }
    }

    /// A plane that every box passes.
    #[inline(always)]
    pub fn everywhere() -> Self {
        Plane { normal: [0.0; 3], rows: [0; 3], offset: 0.0 }
    }

    /// Coordinates of the chosen corner of each child, by component.
    #[inline(always)]
    fn corners<'a>(&self, node: &'a Node) -> [&'a [f32; WIDTH]; 3] {
        self.rows.map(|row| &node.bounds[row])
    }

    /// Signed distance of child `k`'s chosen corner [m], never underestimated for the far corner
    /// and never overestimated for the near one. An empty child is far outside.
    #[inline(always)]
    fn reach(&self, [x, y, z]: [&[f32; WIDTH]; 3], k: usize) -> f32 {
        self.normal[0] * x[k] + self.normal[1] * y[k] + self.normal[2] * z[k] - self.offset
    }
}

/// Finds the nearest hit of each ray (`ANY` = false), or any hit (`ANY` = true).
///
/// `extent` is the largest coordinate in the scene [m]; it sets the margin for rounding.
#[inline(always)]
pub fn trace<const ANY: bool>(
    bvh: &Bvh,
    origin: Vec3,
    rays: &Pyramid,
    extent: f32,
    hits: &mut Hits,
) {
    trace_at_most::<ANY>(u32::MAX, bvh, origin, rays, extent, hits);
}

/// Traces like `trace` with at most `most` triangle tests; false if those did not suffice.
///
/// The hits up to then remain: with `ANY`, they are valid.
#[inline(always)]
pub fn trace_at_most<const ANY: bool>(
    most: u32,
    bvh: &Bvh,
    origin: Vec3,
    rays: &Pyramid,
    extent: f32,
    hits: &mut Hits,
) -> bool {
    search::<ANY>(most, bvh, (origin, &[0.0; LANES]), rays, extent, hits)
}

/// Traces like `trace` beyond `start`: an origin and the minimum distance along each ray [m].
#[inline(always)]
pub fn trace_beyond<const ANY: bool>(
    bvh: &Bvh,
    start: (Vec3, &Lane),
    rays: &Pyramid,
    extent: f32,
    hits: &mut Hits,
) {
    search::<ANY>(u32::MAX, bvh, start, rays, extent, hits);
}

#[inline(always)]
fn search<const ANY: bool>(
    most: u32,
    bvh: &Bvh,
    start: (Vec3, &Lane),
    rays: &Pyramid,
    extent: f32,
    hits: &mut Hits,
) -> bool {
    let planes = planes(start.0, rays, extent);
    let farthest = farthest_of(&hits.distance);
    let sides = Sides::of(&planes.0);
    let mut search =
        Search::<ANY> { triangles: &bvh.triangles, sides, start, rays, hits, left: most };
    traverse(&bvh.nodes, &planes, farthest, &mut search)
}

/// Search for the hits of a tile's rays.
struct Search<'a, const ANY: bool> {
    triangles: &'a [Triangle],
    sides: Sides,
    start: (Vec3, &'a Lane),
    rays: &'a Pyramid,
    hits: &'a mut Hits,
    /// Number of triangles that may still be tested.
    left: u32,
}

impl<const ANY: bool> LeafVisitor for Search<'_, ANY> {
    #[inline(always)]
    fn visit(&mut self, leaf: Range<usize>, farthest: f32) -> Option<f32> {
        self.left = self.left.checked_sub(leaf.len() as u32)?;
        let mut changed = false;
        for number in leaf {
            let triangle = &self.triangles[number];
            if self.sides.exclude(triangle) {
                continue;
            }
            changed |= intersect::<ANY>(triangle, number as u32, self.start, self.rays, self.hits);
        }
        Some(if changed { farthest_of(&self.hits.distance) } else { farthest })
    }
}

/// Lower x, y and z of a box, then upper x, y and z [m].
pub type Bounds = [f32; 6];

/// Visitor of the leaves of a hierarchy.
///
/// This is a trait because closures are not inlined into the functions that are compiled for wide
/// vectors, and then run at a third of the speed.
pub trait LeafVisitor {
    /// Visits a leaf, given the maximum relevant distance [m]; returns the new one, 0 to skip all
    /// other leaves. None ends the traversal.
    fn visit(&mut self, leaf: Range<usize>, farthest: f32) -> Option<f32>;

    /// Box outside which no leaf is relevant, if known.
    #[inline(always)]
    fn bounds(&self) -> Option<&Bounds> {
        None
    }
}

/// Visits the leaves of a hierarchy between the sides of a pyramid, nearest first; false if the
/// visitor ended the traversal.
#[inline(always)]
pub fn traverse(
    nodes: &[Node],
    (sides, near): &([Plane; 4], Plane),
    mut farthest: f32,
    visitor: &mut impl LeafVisitor,
) -> bool {
    let mut stack = [(0u32, 0.0f32); STACK];
    let mut top = usize::from(!nodes.is_empty());
    while top > 0 && farthest > 0.0 {
        top -= 1;
        let (code, nearest) = stack[top];
        if nearest > farthest {
            continue;
        }
        match Child::of(code) {
            Child::Node(number) => {
                let reach = (farthest, visitor.bounds());
                top = push_children(&nodes[number], sides, near, reach, &mut stack, top);
            }
            Child::Leaf(range) => match visitor.visit(range, farthest) {
                Some(distance) => farthest = distance,
                None => return false,
            },
        }
    }
    true
}

/// Sides of the pyramid and the plane from which distance is measured.
#[inline(always)]
fn planes(origin: Vec3, rays: &Pyramid, extent: f32) -> ([Plane; 4], Plane) {
    let margin = extent * 1e-6;
    if !rays.closed {
        return ([0; 4].map(|_| Plane::everywhere()), Plane::everywhere());
    }
    let sides = rays.sides.map(|normal| Plane::new(normal, origin, margin, true));
    (sides, Plane::new(rays.axis, origin, -margin, false))
}

/// Visits the leaves of any hierarchy that the rays may hit nearer than `farthest` [m].
#[inline(always)]
pub fn leaves(
    nodes: &[Node],
    origin: Vec3,
    rays: &Pyramid,
    extent: f32,
    farthest: f32,
    visitor: &mut impl LeafVisitor,
) {
    traverse(nodes, &planes(origin, rays, extent), farthest, visitor);
}

/// The largest of a tile's distances.
#[inline(always)]
pub fn farthest_of(distance: &Lane) -> f32 {
    // Sixteen partial maxima keep the loop a vector loop.
    let mut partial = [0.0f32; 16];
    for row in distance.chunks_exact(16) {
        for k in 0..16 {
            partial[k] = max(partial[k], row[k]);
        }
    }
    partial.iter().fold(0.0, |a, &b| max(a, b))
}

/// Pushes the children that the pyramid may intersect, the nearest last.
#[inline(always)]
fn push_children(
    node: &Node,
    sides: &[Plane; 4],
    near: &Plane,
    (farthest, bounds): (f32, Option<&Bounds>),
    stack: &mut [(u32, f32); STACK],
    mut top: usize,
) -> usize {
    let [left, right, top_side, bottom] = sides;
    let corners =
        [left.corners(node), right.corners(node), top_side.corners(node), bottom.corners(node)];
    let near_corners = near.corners(node);
    let mut nearest = [0.0f32; WIDTH];
    let mut met = [0u8; WIDTH];
    // A single long loop, which the compiler vectorizes to the width of a node.
    for k in 0..WIDTH {
        let across = min(left.reach(corners[0], k), right.reach(corners[1], k));
        let along = min(top_side.reach(corners[2], k), bottom.reach(corners[3], k));
        nearest[k] = near.reach(near_corners, k);
        met[k] = u8::from((min(across, along) >= 0.0) & (nearest[k] <= farthest));
    }
    if let Some([x0, y0, z0, x1, y1, z1]) = bounds {
        let [low_x, low_y, low_z, high_x, high_y, high_z] = &node.bounds;
        for k in 0..WIDTH {
            let across = (low_x[k] <= *x1) & (high_x[k] >= *x0);
            let along = (low_y[k] <= *y1) & (high_y[k] >= *y0);
            met[k] &= u8::from(across & along & (low_z[k] <= *z1) & (high_z[k] >= *z0));
        }
    }
    // One bit set in each byte whose child is intersected.
    let mut met = u64::from_le_bytes(met);
    let first = top;
    while met != 0 {
        let k = met.trailing_zeros() as usize / 8;
        met &= met - 1;
        let mut place = top;
        while place > first && stack[place - 1].1 < nearest[k] {
            stack[place] = stack[place - 1];
            place -= 1;
        }
        stack[place] = (node.children[k], nearest[k]);
        top += 1;
    }
    top
}

/// Tests one triangle against all rays; true if any ray's hit changed.
#[inline(always)]
fn intersect<const ANY: bool>(
    triangle: &Triangle,
    number: u32,
    (origin, nearest): (Vec3, &Lane),
    rays: &Pyramid,
    hits: &mut Hits,
) -> bool {
    let [a, b, c] = triangle.corners.map(|corner| sub(corner, origin));
    // Edge functions: their common sign is the side of each edge on which the ray passes.
    let (bc, ca, ab) = (cross(b, c), cross(c, a), cross(a, b));
    let normal = cross(sub(b, a), sub(c, a));
    let height = dot(normal, a);
    let [dx, dy, dz] = &rays.directions;
    let mut edges = [[0.0f32; LANES]; 3];
    let mut any = false;
    for i in 0..LANES {
        let u = bc[0] * dx[i] + bc[1] * dy[i] + bc[2] * dz[i];
        let v = ca[0] * dx[i] + ca[1] * dy[i] + ca[2] * dz[i];
        let w = ab[0] * dx[i] + ab[1] * dy[i] + ab[2] * dz[i];
        edges[0][i] = u;
        edges[1][i] = v;
        edges[2][i] = w;
        any |= (min(u, min(v, w)) >= 0.0) | (max(u, max(v, w)) <= 0.0);
    }
    if !any {
        return false;
    }
    let mut changed = false;
    for i in 0..LANES {
        let (u, v, w) = (edges[0][i], edges[1][i], edges[2][i]);
        let inside = (min(u, min(v, w)) >= 0.0) | (max(u, max(v, w)) <= 0.0);
        let t = height / (normal[0] * dx[i] + normal[1] * dy[i] + normal[2] * dz[i]);
        let hit = inside & (t > nearest[i]) & (t < hits.distance[i]);
        hits.distance[i] = if hit { if ANY { -1.0 } else { t } } else { hits.distance[i] };
        hits.triangle[i] = if hit { number } else { hits.triangle[i] };
        if !ANY {
            hits.edges[0][i] = if hit { u } else { hits.edges[0][i] };
            hits.edges[1][i] = if hit { v } else { hits.edges[1][i] };
            hits.edges[2][i] = if hit { u + v + w } else { hits.edges[2][i] };
        }
        changed |= hit;
    }
    changed
}
