//! View parameters other than rays: camera pose, LEDs and illumination method.

use crate::poses::pose_of;
use crate::render::led::{Led, point_leds};
use crate::render::material::Surface;
use crate::render::path::Settings;
use crate::render::path::virtual_lights::VirtualLights;
use crate::render::radiosity::{Irradiance, SubsurfaceLight};
use crate::render::scene::SceneData;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::Hits;
use glam::DVec3;
use numpy::ndarray::ArrayView2;
use pyo3::{exceptions::PyValueError, prelude::*};

/// Maximum number of points that represent an LED in direct light for path tracing.
const MOST_POINTS: u32 = 256;

/// Camera pose, LEDs and illumination method of a view.
pub struct View<'a> {
    /// Position of the camera, relative to the wall's center [m].
    pub origin: Vec3,
    /// Rows of the rotation from the camera to the world, and back.
    pub to_world: [Vec3; 3],
    pub to_camera: [Vec3; 3],
    /// The wall's center in the outside world [m].
    pub center: [f64; 3],
    /// LEDs, relative to the wall's center.
    pub leds: Vec<Led>,
    /// LEDs as points, for direct light in path tracing; None where they are discs.
    pub point_leds: Option<Vec<Led>>,
    /// Factor from radiance to linear image value.
    pub exposure: f32,
    /// True if the wall and its contents cast shadows.
    pub shadows: bool,
    /// Settings of path tracing for indirect light; None for direct light only.
    pub paths: Option<Settings>,
    /// Irradiance by indirect light, if computed by radiosity.
    pub irradiance: Option<Irradiance<'a>>,
    /// Virtual lights of the LEDs, if paths are connected to them.
    pub sources: Option<VirtualLights>,
}

impl View<'_> {
    /// View of a camera pose [4 4] and LEDs [k 11] in the camera's frame.
    ///
    /// # Errors
    /// If an array has another shape or is not finite.
    pub fn new(
        wall: &Wall,
        pose: ArrayView2<'_, f64>,
        leds: ArrayView2<'_, f64>,
        exposure: f32,
        shadows: bool,
    ) -> PyResult<Self> {
        if pose.dim() != (4, 4) || !pose.iter().all(|x| x.is_finite()) {
            return Err(PyValueError::new_err("A camera pose must be a finite 4 x 4 matrix."));
        }
        if leds.ncols() != 11 {
            return Err(PyValueError::new_err("LEDs must be of shape (k, 11)."));
        }
        let to_world = [0, 1, 2].map(|r| [0, 1, 2].map(|c| pose[[r, c]] as f32));
        let to_camera = [0, 1, 2].map(|r| [0, 1, 2].map(|c| pose[[c, r]] as f32));
        let (rotation, place) = pose_of(&pose.iter().copied().collect::<Vec<f64>>());
        let leds = leds
            .outer_iter()
            .map(|row| {
                let turned = |k: usize| rotation * DVec3::new(row[k], row[k + 1], row[k + 2]);
                Led {
                    position: wall.localize((turned(0) + place).to_array()),
                    direction: turned(3).as_vec3().to_array(),
                    intensity: [6, 7, 8].map(|k| row[k] as f32),
                    exponent: row[9] as f32,
                    radius: row[10] as f32,
                }
            })
            .collect();
        let origin = wall.localize(place.to_array());
        let (center, paths, irradiance, sources, point_leds) =
            (wall.center, None, None, None, None);
        Ok(View {
            origin,
            to_world,
            to_camera,
            center,
            leds,
            point_leds,
            exposure,
            shadows,
            paths,
            irradiance,
            sources,
        })
    }

    /// Traces paths for indirect light; direct light then comes from points of the LEDs, one per
    /// sample for each.
    pub fn trace_paths(&mut self, settings: Settings) {
        let samples = settings.spp.min(MOST_POINTS);
        self.point_leds = Some(point_leds(&self.leds, samples, settings.seed));
        self.paths = Some(settings);
    }

    /// LEDs of the direct light.
    #[inline(always)]
    pub fn direct_leds(&self) -> &[Led] {
        self.point_leds.as_ref().unwrap_or(&self.leds)
    }

    /// True if LEDs are discs that cast soft shadows.
    pub fn has_soft_shadows(&self) -> bool {
        let is_disc = |led: &Led| led.radius > 0.0;
        self.shadows && self.point_leds.is_none() && self.leds.iter().any(is_disc)
    }

    /// Surface that reflects LED light without entry into the tissue behind it, if light enters it,
    /// and the subsurface light unless paths compute it; `triangles` are `MISS` without a wall.
    #[inline(always)]
    pub fn split_subsurface(
        &self,
        scene: &SceneData,
        surface: &Surface,
        hits: &Hits,
        triangles: &[u32; LANES],
    ) -> (Option<Surface>, Option<SubsurfaceLight>) {
        let is_traced = self.paths.is_some() || self.irradiance.is_some();
        let without_base =
            (is_traced && scene.tissue.is_some()).then(|| surface.without_base(triangles));
        let irradiance = self.irradiance.as_ref();
        (without_base, irradiance.and_then(|light| light.subsurface(surface, hits, triangles)))
    }
}
