//! Rows of light transport through tissue: entry points of the light that exits at a node.

use super::GatherPoints;
use crate::render::material::refract_into;
use crate::render::path::bsdf::cosine_direction;
use crate::render::path::sobol::{dimension, hash, point, unit};
use crate::render::path::subsurface::{
    Interface, Medium, PlaneInterface, RandomStream, SubsurfaceExit, Tissue, TissueRay, random_walk,
};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::MISS;

/// Walks of a row: for wide faces, and for small ones, where a vertex averages several nodes.
const WALKS: [u32; 2] = [128, 64];
/// Distance in free paths, or in edges of faces if these are longer, within which entering light
/// counts as light on the point itself.
const NEAR: f32 = 0.5;
/// Maximum distance from a node at which walks start on its faces, as a fraction of their height.
const STAR: f32 = 0.5;
/// Base color below which the interface transmits no light out again.
const BLACK: f32 = 1e-3;

/// Dimensions of a row's random numbers.
const FACE: u32 = 1;
const CORNER: u32 = 2;
const DIRECTION: u32 = 3;
const END: u32 = 4;

/// Light from another node.
#[derive(Clone, Copy)]
pub struct Link {
    /// The other node.
    pub from: u32,
    /// Fraction of red, green and blue, as in `Row`.
    pub weight: Vec3,
}

/// Fractions of irradiance that exit at a node, relative to the diffuse light that a flat wall
/// returns.
pub struct Row {
    /// Fraction of light on the node itself.
    pub near: Vec3,
    /// Fractions of light on other nodes.
    pub far: Box<[Link]>,
}

impl Row {
    /// Sum of all fractions, for diffuse light.
    pub fn total(&self) -> Vec3 {
        self.far.iter().fold(self.near, |sum, link| add(sum, link.weight))
    }
}

/// Start of a walk.
struct Start {
    place: Vec3,
    /// Unit normal of the face.
    face_normal: Vec3,
    direction: Vec3,
    /// Transmittance of the interface on entry, relative to the mean.
    passes: f32,
}

/// Sums over walks.
struct Sum {
    near: Vec3,
    far: Vec<Link>,
    /// Sum of walks on the wall, minus that of the same walks on a plane.
    more: Vec3,
}

/// Traces the row of a node at rest, with the mean base color around it.
///
/// A flat wall returns exactly the base color. Each walk is also made, with the same random
/// numbers, behind the plane of the face where it starts: the difference between the two is the
/// effect of the wall's shape, with far less noise than the walks themselves (control variates).
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn trace_row(
    wall: &Wall,
    tissue: &Tissue,
    nodes: &GatherPoints,
    (node, color): (usize, Vec3),
) -> Row {
    let medium = tissue.medium(color);
    let vertex = nodes.vertex[node] as usize;
    let edge = (wall.area_around(vertex) / 2.6).sqrt();
    let reach = tissue.scattering.map(|scattering| NEAR * max(1.0 / scattering, edge));
    let key = hash(node as u32);
    let walks = WALKS[usize::from(edge < nodes.spacing[node])];
    let mut sum = Sum { near: [0.0; 3], far: Vec::new(), more: [0.0; 3] };
    for number in 0..walks {
        let start = Start::draw(wall, tissue, vertex, (key, number));
        let exit = start.walk(wall, &medium, (key, number));
        let level = PlaneInterface {
            point: start.place,
            normal: start.face_normal,
            offset: Interface::offset(wall),
        };
        let plain = start.walk(&level, &medium, (key, number));
        let weight =
            |exit: &Option<SubsurfaceExit>| exit.as_ref().map_or([0.0; 3], |exit| exit.throughput);
        let difference = sub(weight(&exit), weight(&plain));
        sum.more = add(sum.more, scale(difference, start.passes));
        if let Some(exit) = exit {
            let from = met(wall, nodes, &exit, (key, number));
            sum.take(&start, &exit, reach, from);
        }
    }
    sum.row(color, walks as f32)
}

impl Start {
    /// Samples a point near a vertex, and a direction into the tissue as of diffuse light.
    fn draw(wall: &Wall, tissue: &Tissue, vertex: usize, (key, number): (u32, u32)) -> Self {
        let [first, second] = point(dimension(key, FACE), number);
        let [third, fourth] = point(dimension(key, CORNER), number);
        let around = wall.faces_around(vertex);
        let area = wall.area_around(vertex);
        let mut left = first * area;
        let mut chosen = [[0.0; 3]; 4];
        for &face in around {
            let corners = wall.faces[face as usize];
            let own = corners.iter().position(|&v| v as usize == vertex).unwrap_or(0);
            let [a, b, c] = [0, 1, 2].map(|k| wall.vertices[corners[(own + k) % 3] as usize]);
            let normal = cross(sub(b, a), sub(c, a));
            chosen = [a, b, c, normal];
            left -= 0.5 * dot(normal, normal).sqrt();
            if left <= 0.0 {
                break;
            }
        }
        // Samples each face by the vertex's weight: Dirichlet's (2, 1, 1), contracted towards it.
        let mut cuts = [second, third, fourth];
        cuts.sort_unstable_by(f32::total_cmp);
        let [a, b, c, normal] = chosen;
        let (to_b, to_c) = (STAR * (cuts[2] - cuts[1]), STAR * (1.0 - cuts[2]));
        let place = add(a, add(scale(sub(b, a), to_b), scale(sub(c, a), to_c)));
        let face_normal = normalize(normal);
        let (view, cosine) =
            cosine_direction(face_normal, point(dimension(key, DIRECTION), number));
        let direction = refract_into(view, face_normal, tissue.ior);
        Start { place, face_normal, direction, passes: tissue.transmittance(cosine) }
    }

    /// Walks behind an interface until light exits.
    #[inline(always)]
    fn walk(
        &self,
        interface: &impl Interface,
        medium: &Medium,
        (key, number): (u32, u32),
    ) -> Option<SubsurfaceExit> {
        let origin = sub(self.place, scale(self.face_normal, interface.offset()));
        let ray = TissueRay { origin, direction: self.direction, from: MISS };
        random_walk(interface, medium, ray, &mut RandomStream::new(key, number))
    }
}

/// Node at which a walk ends: that of a corner of the face, sampled by the corners' weights.
fn met(wall: &Wall, nodes: &GatherPoints, exit: &SubsurfaceExit, (key, number): (u32, u32)) -> u32 {
    let [a, b, c] = wall.bvh.corners[exit.hit.triangle as usize];
    let inverse = 1.0 / exit.hit.edges[2];
    let (wa, wb) = (exit.hit.edges[0] * inverse, exit.hit.edges[1] * inverse);
    let drawn = unit(hash(dimension(key, END) ^ hash(number)));
    let corner = if drawn < wa {
        a
    } else if drawn < wa + wb {
        b
    } else {
        c
    };
    nodes.of_vertex[corner as usize]
}

impl Sum {
    /// Adds light that has traveled from `start` to an exit at a node.
    fn take(&mut self, start: &Start, exit: &SubsurfaceExit, reach: Vec3, from: u32) {
        let offset = sub(exit.point, start.place);
        let square = dot(offset, offset);
        let is_same_side = dot(exit.face_normal, start.face_normal) > 0.0;
        let weight = scale(exit.throughput, start.passes);
        let near = reach.map(|reach| is_same_side && square < reach * reach);
        let far = [0, 1, 2].map(|k| if near[k] { 0.0 } else { weight[k] });
        self.near = add(self.near, sub(weight, far));
        if far != [0.0; 3] {
            self.far.push(Link { from, weight: far });
        }
    }

    /// The row, scaled so that it sums to the light that the wall returns.
    fn row(mut self, color: Vec3, walks: f32) -> Row {
        self.far.sort_by_key(|link| link.from);
        let far: Vec<Link> = self
            .far
            .chunk_by(|a, b| a.from == b.from)
            .map(|run| Link {
                from: run[0].from,
                weight: run.iter().fold([0.0; 3], |sum, link| add(sum, link.weight)),
            })
            .collect();
        let found = far.iter().fold(self.near, |sum, link| add(sum, link.weight));
        let factor = [0, 1, 2].map(|k| {
            let total = 1.0 + self.more[k] / (walks * max(color[k], BLACK));
            clamp(total, 0.0, 1.0 / max(color[k], BLACK)) / max(found[k], 1e-20)
        });
        let is_known = [0, 1, 2].map(|k| color[k] > BLACK && found[k] > 0.0);
        let scaled =
            |weight: Vec3| [0, 1, 2].map(|k| if is_known[k] { weight[k] * factor[k] } else { 0.0 });
        let near = scaled(self.near);
        Row {
            near: [0, 1, 2].map(|k| if is_known[k] { near[k] } else { 1.0 }),
            far: far.iter().map(|link| Link { weight: scaled(link.weight), ..*link }).collect(),
        }
    }
}
