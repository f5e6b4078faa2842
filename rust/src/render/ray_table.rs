//! Rays of a camera: one unit direction per pixel, divided into tiles once.

use crate::simd::f32x64::*;
use crate::wall::packet::Pyramid;
use numpy::{PyReadonlyArray3, ndarray::ArrayView3};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Angle between pixels above which rays are traced in bundles [rad]: images of up to some 150
/// pixels across a capsule's field, whose packets visit many triangles.
const WIDE_ANGLE: f32 = 0.016;

/// Rays of one tile in the camera frame; lane `i` is the pixel at row `i / TILE`, column `i %
/// TILE`.
pub struct TileRays {
    /// Directions and the pyramid around them.
    pub pyramid: Pyramid,
    /// Lanes that are pixels of the image and inside the lens's field.
    pub used: [bool; LANES],
    /// True if any lane is used.
    pub any: bool,
    /// Angle between neighboring pixels [rad]; sets the footprint of a pixel on a texture.
    pub pixel_angle: f32,
    /// True if the rays are too far apart to be traced as one packet.
    pub is_wide: bool,
}

/// Unit ray directions of every pixel of a camera [h w 3]; NaN outside the lens's field.
#[pyclass(frozen, module = "vrcaps._core")]
pub struct RayTable {
    /// Image width [pixels].
    pub width: usize,
    /// Image height [pixels].
    pub height: usize,
    /// Tiles, row by row.
    pub tiles: Vec<TileRays>,
    /// Direction of each pixel, and 1 inside the lens's field, 0 outside.
    pub pixels: Vec<[f32; 4]>,
}

impl RayTable {
    /// Number of tiles in a row of tiles.
    pub fn columns(&self) -> usize {
        self.width.div_ceil(TILE)
    }

    /// Unit direction of a pixel; None outside the lens's field.
    pub fn direction(&self, x: usize, y: usize) -> Option<Vec3> {
        let [a, b, c, used] = self.pixels[y * self.width + x];
        (used > 0.0).then_some([a, b, c])
    }
}

#[pymethods]
impl RayTable {
    #[new]
    fn new(directions: PyReadonlyArray3<'_, f32>) -> PyResult<Self> {
        let rays = directions.as_array();
        let (height, width, components) = rays.dim();
        if components != 3 || height == 0 || width == 0 {
            return Err(PyValueError::new_err("Ray directions must be of shape (h, w, 3)."));
        }
        let (rows, columns) = (height.div_ceil(TILE), width.div_ceil(TILE));
        let tiles: Vec<TileRays> = (0..rows * columns)
            .map(|t| cut(&rays, t / columns * TILE, t % columns * TILE))
            .collect();
        let pixel = |k: usize| {
            let (y, x) = (k / width, k % width);
            let (tile, lane) = (&tiles[y / TILE * columns + x / TILE], y % TILE * TILE + x % TILE);
            let [a, b, c] = at(&tile.pyramid.directions, lane);
            [a, b, c, f32::from(u8::from(tile.used[lane]))]
        };
        let pixels = (0..height * width).map(pixel).collect();
        Ok(RayTable { width, height, tiles, pixels })
    }

    /// Height and width in pixels.
    #[getter]
    fn shape(&self) -> (usize, usize) {
        (self.height, self.width)
    }
}

fn cut(rays: &ArrayView3<'_, f32>, row: usize, column: usize) -> TileRays {
    let (height, width, _) = rays.dim();
    let (mut directions, mut used) = ([[0.0; LANES]; 3], [false; LANES]);
    for i in 0..LANES {
        let (y, x) = (row + i / TILE, column + i % TILE);
        if y < height && x < width && rays[[y, x, 0]].is_finite() {
            used[i] = true;
            let direction = normalize([0, 1, 2].map(|k| rays[[y, x, k]]));
            for k in 0..3 {
                directions[k][i] = direction[k];
            }
        }
    }
    let mut pyramid = Pyramid::around(directions, &used);
    for i in (0..LANES).filter(|&i| !used[i]) {
        for k in 0..3 {
            pyramid.directions[k][i] = pyramid.axis[k];
        }
    }
    let pixel_angle = pixel_angle(&pyramid.directions, &used);
    let is_wide = !pyramid.closed || pixel_angle > WIDE_ANGLE;
    TileRays { any: used.contains(&true), pyramid, used, pixel_angle, is_wide }
}

/// Mean angle between horizontal neighbors that are both used.
fn pixel_angle(directions: &Lane3, used: &[bool; LANES]) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0);
    for i in (0..LANES - 1).filter(|i| i % TILE != TILE - 1) {
        if used[i] && used[i + 1] {
            let step = sub(at(directions, i + 1), at(directions, i));
            sum += dot(step, step).sqrt();
            count += 1.0;
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}
