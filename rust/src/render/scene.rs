//! Attributes of a wall's surface for rendering.

use crate::render::material::Material;
use crate::render::path::subsurface::Tissue;
use crate::render::texture::Texture;
use crate::simd::f32x64::Vec3;
use crate::wall::Wall;
use numpy::{PyReadonlyArray1, PyReadonlyArray3};
use pyo3::{exceptions::PyValueError, prelude::*};
use std::ops::Deref;

/// Data of one face; stored together because they are read together.
#[derive(Clone, Copy)]
pub struct FaceData {
    /// Texture coordinates of each corner.
    pub uv: [[f32; 2]; 3],
    /// Ratio of the gradients of u and v over the face of the wall at rest; 0 if it has none.
    pub aspect: f32,
    /// Class.
    pub label: u8,
    /// Lesion ID.
    pub instance: u16,
}

/// Attributes of a wall's faces and vertices.
pub struct SceneData {
    /// Data of each face.
    pub faces: Vec<FaceData>,
    /// Distance of each vertex along the centerline [m].
    pub arc_length: Vec<f32>,
    /// Textures, or None for a uniform wall.
    pub texture: Option<TextureHandle>,
    /// Linear base color of a uniform wall.
    pub albedo: Vec3,
    /// Roughness of a uniform wall.
    pub roughness: f32,
    /// Reflectance parameters that are uniform over the wall.
    pub material: Material,
    /// Tissue behind the wall, if light passes through it.
    pub tissue: Option<Tissue>,
}

impl SceneData {
    /// Checks that a wall has the numbers of faces and vertices of this scene.
    pub fn check_size(&self, wall: &Wall) -> PyResult<()> {
        if self.faces.len() == wall.faces.len() && self.arc_length.len() == wall.vertices.len() {
            return Ok(());
        }
        let what = "Scene and wall have different numbers of faces or vertices.";
        Err(PyValueError::new_err(what))
    }
}

/// Tissue as passed by Python.
type OpticalProperties = (Vec3, f32, f32, Vec<f32>, f32, Vec<f32>);

/// A texture shared with Python.
pub struct TextureHandle(Py<Texture>);

impl Deref for TextureHandle {
    type Target = Texture;

    fn deref(&self) -> &Texture {
        self.0.get()
    }
}

/// Scene data of a wall: labels, gut coordinates, textures and reflectance.
#[pyclass(frozen, module = "vrcaps._core")]
pub struct Scene {
    /// Attributes of the wall.
    pub data: SceneData,
}

#[pymethods]
impl Scene {
    /// Takes uv [m 3 2], `aspect` [m] of `FaceData`, label [m] and instance [m] of faces, arc length
    /// [n] of vertices in meters,
    /// `texture` or a uniform linear `albedo` and `roughness`, and `reflectance` (refractive index,
    /// clearcoat strength, clearcoat roughness α). `tissue` lets light pass through the wall:
    /// reduced scattering of red, green and blue [1/m], refractive index, fraction of diffuse light
    /// that enters, √(1 − single-scattering albedo) of base colors 0 to 1 in uniform steps, and
    /// `mean_cosine` and `angular_slopes` of `Tissue`.
    #[new]
    #[pyo3(signature = (uv, aspect, label, instance, arc_length, *, texture, albedo, roughness, reflectance, tissue=None))]
    #[allow(clippy::too_many_arguments)] // one keyword each
    fn new(
        uv: PyReadonlyArray3<'_, f32>,
        aspect: PyReadonlyArray1<'_, f32>,
        label: PyReadonlyArray1<'_, u8>,
        instance: PyReadonlyArray1<'_, u16>,
        arc_length: PyReadonlyArray1<'_, f32>,
        texture: Option<Py<Texture>>,
        albedo: Vec3,
        roughness: f32,
        reflectance: (f32, f32, f32),
        tissue: Option<OpticalProperties>,
    ) -> PyResult<Self> {
        let (uv, label, instance) = (uv.as_array(), label.as_array(), instance.as_array());
        let aspect = aspect.as_array();
        let (faces, corners, components) = uv.dim();
        let same = [label.len(), instance.len(), aspect.len()] == [faces; 3];
        if (corners, components) != (3, 2) || !same {
            return Err(PyValueError::new_err(
                "Texture coordinates must be of shape (m, 3, 2), other data of faces of shape (m,).",
            ));
        }
        let (ior, clearcoat, clearcoat_alpha) = reflectance;
        let face = |f: usize| FaceData {
            uv: [0, 1, 2].map(|corner| [uv[[f, corner, 0]], uv[[f, corner, 1]]]),
            aspect: aspect[f],
            label: label[f],
            instance: instance[f],
        };
        let data = SceneData {
            faces: (0..faces).map(face).collect(),
            arc_length: arc_length.as_array().to_vec(),
            texture: texture.map(TextureHandle),
            albedo,
            roughness,
            material: Material { ior, clearcoat, clearcoat_alpha },
            tissue: tissue.map(
                |(
                    scattering,
                    ior,
                    diffuse_transmittance,
                    albedo_roots,
                    mean_cosine,
                    angular_slopes,
                )| {
                    Tissue {
                        scattering,
                        ior,
                        diffuse_transmittance,
                        albedo_roots,
                        mean_cosine,
                        angular_slopes,
                    }
                },
            ),
        };
        Ok(Scene { data })
    }
}
