//! Mean albedo of the wall around each gather point.

use super::gather_points::GatherPoints;
use crate::render::scene::SceneData;
use crate::simd::f32x64::*;
use crate::wall::Wall;

/// Means over faces, weighted by area.
pub struct PatchAlbedo {
    /// Base color around each gather point.
    pub albedo: Vec<Vec3>,
    /// One over the area that each gather point represents [1/m²].
    pub per_area: Vec<f32>,
    /// Roughness of the wall.
    pub roughness: f32,
}

/// Faces of one tile.
struct Faces {
    albedo: Lane3,
    roughness: Lane,
    /// [m²]
    area: Lane,
}

impl PatchAlbedo {
    /// Averages the scene data of a wall.
    pub fn mean(wall: &Wall, scene: &SceneData, gather_points: &GatherPoints) -> Self {
        let mut sums = vec![([0.0f32; 3], 0.0f32); gather_points.vertex.len()];
        let (mut roughness, mut total) = (0.0f64, 0.0f64);
        for first in (0..wall.bvh.triangles.len()).step_by(LANES) {
            let faces = Faces::fetch(wall, scene, first);
            for i in 0..LANES.min(wall.bvh.triangles.len() - first) {
                let area = faces.area[i];
                roughness += f64::from(faces.roughness[i] * area);
                total += f64::from(area);
                for v in wall.bvh.corners[first + i] {
                    let sum = &mut sums[gather_points.of_vertex[v as usize] as usize];
                    sum.0 = add(sum.0, scale(at(&faces.albedo, i), area / 3.0));
                    sum.1 += area / 3.0;
                }
            }
        }
        let per_area: Vec<f32> = sums.iter().map(|sum| 1.0 / max(sum.1, 1e-30)).collect();
        let albedo = sums.iter().zip(&per_area).map(|(sum, &one)| scale(sum.0, one)).collect();
        PatchAlbedo { albedo, per_area, roughness: (roughness / total.max(1e-30)) as f32 }
    }
}

impl Faces {
    /// Faces in the order of the hierarchy, starting at index `first`.
    fn fetch(wall: &Wall, scene: &SceneData, first: usize) -> Self {
        let zero = [0.0; LANES];
        let (mut uv, mut footprint) = ([zero; 2], [zero; 2]);
        let mut faces = Faces {
            albedo: scene.albedo.map(|x| [x; LANES]),
            roughness: [scene.roughness; LANES],
            area: zero,
        };
        for (i, triangle) in wall.bvh.triangles[first..].iter().take(LANES).enumerate() {
            let [a, b, c] = triangle.corners;
            let normal = cross(sub(b, a), sub(c, a));
            faces.area[i] = 0.5 * dot(normal, normal).sqrt();
            let [at_a, at_b, at_c] = scene.faces[triangle.face as usize].uv;
            for k in 0..2 {
                uv[k][i] = (at_a[k] + at_b[k] + at_c[k]) / 3.0;
                let low = min(at_a[k], min(at_b[k], at_c[k]));
                let high = max(at_a[k], max(at_b[k], at_c[k]));
                footprint[k][i] = 0.5 * (high - low);
            }
        }
        if let Some(texture) = &scene.texture {
            let texels = texture.fetch(&uv, &footprint, &[1.0; LANES]);
            faces.albedo = texels.albedo;
            faces.roughness = texels.roughness;
        }
        faces
    }
}
