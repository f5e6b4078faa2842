//! Shading of hits: attributes of the wall at each hit, and the light that it reflects.

use crate::render::led::Led;
use crate::render::material::{Material, Surface, add_light};
use crate::render::radiosity::SubsurfaceLight;
use crate::render::scene::{FaceData, SceneData};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::bundle::{RAYS, lit_by};
use crate::wall::bvh::Triangle;
use crate::wall::packet::{Hits, MISS};
use crate::wall::visibility::visible_tile;

/// Attributes of the wall at the hit of each ray of a tile.
pub struct Attributes {
    /// Lanes that hit the wall.
    pub hit: [bool; LANES],
    /// Face hit, −1 for none.
    pub face: [i32; LANES],
    /// Weights of the face's first and second corner.
    pub weights: [Lane; 2],
    /// Hit point [m].
    pub position: Lane3,
    /// Unit direction to the viewer.
    pub view: Lane3,
    /// Smooth unit normal on the viewer's side.
    pub normal: Lane3,
    /// Minimum cosine of a shading normal to the viewer's direction, see `Face::least_facing`.
    pub least_facing: Lane,
    /// Texture coordinates.
    pub uv: [Lane; 2],
    /// Factor on the width of the texels, see `Face::streak`.
    pub streak: Lane,
    /// Surface gradients of the texture coordinates [1/m].
    pub gradients: [Lane3; 2],
    /// Distance along the centerline [m].
    pub arc_length: Lane,
    /// Segment or tissue class.
    pub label: [u8; LANES],
    /// Lesion ID.
    pub instance: [u16; LANES],
}

/// A face of the wall, fetched once for neighboring rays that hit it.
struct Face {
    number: usize,
    corners: [usize; 3],
    data: FaceData,
    gradients: [Vec3; 2],
    /// Factor on the width of its texels that removes streaks.
    streak: f32,
    /// A quarter of the sine of the angle by which the normal turns from the face's center to its
    /// corners.
    ///
    /// A piece of wall that turns by that angle up to an outline has half of it as its mean cosine;
    /// a single facet in its place would be black wherever its smooth normal is edge-on. A quarter
    /// removes the black and changes the rest of an image least.
    least_facing: f32,
}

impl Face {
    /// Face of a triangle, whose corners are still in the cache from tracing.
    #[inline(always)]
    fn fetch(wall: &Wall, scene: &SceneData, triangle: usize) -> Self {
        let Triangle { corners: [a, b, c], face } = wall.bvh.triangles[triangle];
        let (ab, ac) = (sub(b, a), sub(c, a));
        let normal = cross(ab, ac);
        let inverse = 1.0 / max(dot(normal, normal), 1e-30);
        // Gradients of the weights of b and c over the face.
        let of_b = scale(cross(ac, normal), inverse);
        let of_c = scale(cross(normal, ab), inverse);
        let data = scene.faces[face as usize];
        let [uv_a, uv_b, uv_c] = data.uv;
        let gradient =
            |k: usize| add(scale(of_b, uv_b[k] - uv_a[k]), scale(of_c, uv_c[k] - uv_a[k]));
        let gradients = [gradient(0), gradient(1)];
        let corners = wall.bvh.corners[triangle].map(|v| v as usize);
        let [na, nb, nc] = corners.map(|v| wall.normals[v]);
        let turn = dot(add(add(na, nb), nc), normal) * inverse.sqrt() * (1.0 / 3.0);
        Face {
            number: face as usize,
            corners,
            data,
            gradients,
            streak: streak(gradients, data.aspect),
            least_facing: 0.25 * max(1.0 - turn * turn, 0.0).sqrt(),
        }
    }
}

/// Ratio of the stretch of a wall along u and v, relative to that at rest, above which its texture is
/// drawn coarser. Tissue that is gathered around the gut and pulled along it folds below the mesh's
/// size, so its detail is not a streak.
const STREAK: f32 = 1.7;

/// Factor on the width of a face's texels that removes streaks, from the gradients of u and v and
/// their ratio at rest.
#[inline(always)]
fn streak([along_u, along_v]: [Vec3; 2], aspect: f32) -> f32 {
    let square = dot(along_u, along_u) / max(dot(along_v, along_v) * aspect * aspect, 1e-30);
    let most = max(square, 1.0 / max(square, 1e-30)).sqrt();
    if aspect > 0.0 { clamp(most / STREAK, 1.0, 64.0) } else { 1.0 }
}

/// Looks up the wall's attributes at every hit.
#[inline(always)]
pub fn attributes(
    wall: &Wall,
    scene: &SceneData,
    origin: Vec3,
    directions: &Lane3,
    hits: &Hits,
) -> Attributes {
    let (mut position, mut view) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
    for i in 0..LANES {
        for k in 0..3 {
            position[k][i] = origin[k] + hits.distance[i] * directions[k][i];
            view[k][i] = -directions[k][i];
        }
    }
    attributes_at(wall, scene, position, view, hits)
}

/// Attributes of hits of arbitrary rays; `view` holds unit directions back along them.
#[inline(always)]
pub fn attributes_at(
    wall: &Wall,
    scene: &SceneData,
    position: Lane3,
    view: Lane3,
    hits: &Hits,
) -> Attributes {
    let mut out = Attributes {
        hit: [false; LANES],
        face: [-1; LANES],
        weights: [[0.0; LANES]; 2],
        position,
        view,
        normal: [[0.0; LANES]; 3],
        least_facing: [0.0; LANES],
        uv: [[0.0; LANES]; 2],
        streak: [1.0; LANES],
        gradients: [[[0.0; LANES]; 3]; 2],
        arc_length: [0.0; LANES],
        label: [0; LANES],
        instance: [0; LANES],
    };
    for i in 0..LANES {
        let inverse = 1.0 / hits.edges[2][i];
        out.hit[i] = hits.triangle[i] != MISS;
        out.weights[0][i] = hits.edges[0][i] * inverse;
        out.weights[1][i] = hits.edges[1][i] * inverse;
    }
    let mut last = (MISS, None);
    for i in 0..LANES {
        let triangle = hits.triangle[i];
        if triangle == MISS {
            continue;
        }
        if triangle != last.0 {
            last = (triangle, Some(Face::fetch(wall, scene, triangle as usize)));
        }
        if let Some(face) = &last.1 {
            fill_lane(&mut out, wall, scene, face, i);
        }
    }
    turn_to_viewer(&mut out, &hits.edges[2]);
    out
}

#[inline(always)]
fn fill_lane(out: &mut Attributes, wall: &Wall, scene: &SceneData, face: &Face, i: usize) {
    let (wa, wb) = (out.weights[0][i], out.weights[1][i]);
    let wc = 1.0 - wa - wb;
    let [a, b, c] = face.corners;
    let (na, nb, nc) = (wall.normals[a], wall.normals[b], wall.normals[c]);
    for k in 0..3 {
        out.normal[k][i] = na[k] * wa + nb[k] * wb + nc[k] * wc;
        out.gradients[0][k][i] = face.gradients[0][k];
        out.gradients[1][k][i] = face.gradients[1][k];
    }
    out.least_facing[i] = face.least_facing;
    out.streak[i] = face.streak;
    let [uv_a, uv_b, uv_c] = face.data.uv;
    for k in 0..2 {
        out.uv[k][i] = uv_a[k] * wa + uv_b[k] * wb + uv_c[k] * wc;
    }
    let arc = &scene.arc_length;
    out.arc_length[i] = arc[a] * wa + arc[b] * wb + arc[c] * wc;
    out.label[i] = face.data.label;
    out.instance[i] = face.data.instance;
    out.face[i] = face.number as i32;
}

/// Normalizes normals and turns them to the viewer's side.
///
/// The side of the face sets the sign; a smooth normal that still points away, near an outline, is
/// bent to the horizon.
#[inline(always)]
fn turn_to_viewer(out: &mut Attributes, leaving: &Lane) {
    for i in 0..LANES {
        let (normal, view) = (at(&out.normal, i), at(&out.view, i));
        let sign = if leaving[i] > 0.0 { -1.0 } else { 1.0 };
        let unit = scale(normal, sign / max(dot(normal, normal), 1e-30).sqrt());
        let bent = sub(unit, scale(view, min(dot(unit, view), 0.0)));
        let inverse = 1.0 / max(dot(bent, bent), 1e-30).sqrt();
        for k in 0..3 {
            out.normal[k][i] = bent[k] * inverse;
        }
    }
}

/// Normalizes a shading normal, with a cosine to the viewer of at least `least`.
#[inline(always)]
fn face_viewer(normal: Vec3, view: Vec3, least: f32) -> Vec3 {
    let (square, towards) = (dot(normal, normal), dot(normal, view));
    let lacking = max(least * square.sqrt() - towards, 0.0);
    let square = max(square + lacking * (2.0 * towards + lacking), 1e-12);
    scale(add(normal, scale(view, lacking)), 1.0 / square.sqrt())
}

/// Material at the hits: base color, roughness and relief.
#[inline(always)]
pub fn surface(
    scene: &SceneData,
    attributes: &Attributes,
    distance: &Lane,
    pixel_angle: f32,
) -> Surface {
    let mut surface = Surface {
        position: attributes.position,
        normal: attributes.normal,
        view: attributes.view,
        albedo: [[0.0; LANES]; 3],
        roughness: [scene.roughness; LANES],
    };
    let Some(texture) = &scene.texture else {
        for k in 0..3 {
            surface.albedo[k] = [scene.albedo[k]; LANES];
        }
        for i in 0..LANES {
            let view = at(&attributes.view, i);
            let normal = face_viewer(at(&attributes.normal, i), view, attributes.least_facing[i]);
            for k in 0..3 {
                surface.normal[k][i] = normal[k];
            }
        }
        return surface;
    };
    let footprint = footprint(attributes, distance, pixel_angle);
    let texels = texture.fetch(&attributes.uv, &footprint, &attributes.streak);
    let [along_u, along_v] = &attributes.gradients;
    for i in 0..LANES {
        let rise = add(
            scale(at(along_u, i), texels.slope[0][i]),
            scale(at(along_v, i), texels.slope[1][i]),
        );
        let tilted = sub(at(&attributes.normal, i), rise);
        let normal = face_viewer(tilted, at(&attributes.view, i), attributes.least_facing[i]);
        for k in 0..3 {
            surface.normal[k][i] = normal[k];
        }
    }
    surface.albedo = texels.albedo;
    surface.roughness = texels.roughness;
    surface
}

/// Fraction of the texture's width and height that each pixel covers.
#[inline(always)]
fn footprint(attributes: &Attributes, distance: &Lane, pixel_angle: f32) -> [Lane; 2] {
    let mut result = [[0.0; LANES]; 2];
    for (k, lanes) in result.iter_mut().enumerate() {
        for i in 0..LANES {
            let cosine = max(dot(at(&attributes.normal, i), at(&attributes.view, i)), 0.05);
            let gradient = at(&attributes.gradients[k], i);
            let size = distance[i] * pixel_angle / cosine.sqrt();
            lanes[i] = size * dot(gradient, gradient).sqrt();
        }
    }
    result
}

/// Adds the radiance that an LED's light leaves towards the viewer, including the subsurface light
/// if enabled; `visible` is the visible fraction of the LED.
#[inline(always)]
pub fn add_all_light(
    (surface, subsurface): (&Surface, Option<&SubsurfaceLight>),
    material: &Material,
    led: &Led,
    visible: &Lane,
    radiance: &mut Lane3,
) {
    add_light(surface, material, led, visible, radiance);
    if let Some(subsurface) = subsurface {
        subsurface.add(surface, led, visible, radiance);
    }
}

/// Method of shadow computation.
#[derive(Clone, Copy)]
pub enum Shadows<'a> {
    /// No shadows.
    None,
    /// Rays from each LED to all points of a tile, which lie close together.
    ByLed,
    /// Rays from each point to all LEDs.
    ByPoint,
    /// Given visible fraction of each LED.
    Known(&'a [Lane]),
}

/// 1 in lanes that are `true`, 0 in others.
#[inline(always)]
pub fn fraction(lanes: &[bool; LANES]) -> Lane {
    let mut fraction = [0.0; LANES];
    for i in 0..LANES {
        fraction[i] = if lanes[i] { 1.0 } else { 0.0 };
    }
    fraction
}

/// Radiance towards the viewer [W/(sr·m²)]; zero without a hit.
#[inline(always)]
pub fn light(
    wall: &Wall,
    material: &Material,
    leds: &[Led],
    shadows: Shadows<'_>,
    (surface, subsurface): (&Surface, Option<&SubsurfaceLight>),
    hit: &[bool; LANES],
) -> Lane3 {
    let mut radiance = [[0.0; LANES]; 3];
    for (chunk, some) in leds.chunks(RAYS).enumerate() {
        let by_point = match shadows {
            Shadows::ByPoint => {
                let source = |_: usize, k: usize| some[k].position;
                Some(lit_by(wall, (some.len(), source), &surface.position, hit))
            }
            _ => None,
        };
        for (k, led) in some.iter().enumerate() {
            let visible = match (shadows, &by_point) {
                (Shadows::Known(visible), _) => visible[chunk * RAYS + k],
                (Shadows::ByLed, _) => {
                    fraction(&visible_tile(wall, led.position, &surface.position, hit))
                }
                (_, Some(sources)) => fraction(&std::array::from_fn(|i| sources[i] >> k & 1 == 1)),
                (_, None) => fraction(hit),
            };
            if visible.iter().any(|&visible| visible > 0.0) {
                add_all_light((surface, subsurface), material, led, &visible, &mut radiance);
            }
        }
    }
    radiance
}
