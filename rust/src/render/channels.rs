//! The arrays of an image that tiles write into.

use crate::simd::f32x64::*;
use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};

/// Pixels between those whose surface is written sparsely, the first in the middle of a square.
pub const STEP: usize = 4;

/// How many of so many pixels in a row are written sparsely.
pub fn sparse(size: usize) -> usize {
    (size + STEP / 2 - 1) / STEP
}

/// Channels of an image, or of a row of its tiles; those not asked for are absent.
#[derive(Default)]
pub struct Channels<'a> {
    pub rgb: Option<&'a mut [u8]>,
    pub radiance: Option<&'a mut [f32]>,
    pub planes: Option<Planes<'a>>,
    pub depth: Option<&'a mut [f32]>,
    pub ray_distance: Option<&'a mut [f32]>,
    pub normal: Option<&'a mut [f32]>,
    pub label: Option<&'a mut [u8]>,
    pub instance: Option<&'a mut [u16]>,
    pub albedo: Option<&'a mut [f32]>,
    pub arc_length: Option<&'a mut [f32]>,
    pub position: Option<&'a mut [f32]>,
    pub face: Option<&'a mut [i32]>,
    pub weights: Option<&'a mut [f32]>,
    pub sparse_position: Option<&'a mut [f32]>,
    pub sparse_face: Option<&'a mut [i32]>,
    pub sparse_weights: Option<&'a mut [f32]>,
    pub sparse_refraction: Option<&'a mut [u8]>,
    pub foreground_label: Option<&'a mut [u8]>,
    pub foreground_instance: Option<&'a mut [u16]>,
    pub foreground_depth: Option<&'a mut [f32]>,
    pub refraction_label: Option<&'a mut [u8]>,
}

/// Radiance by colours, with a margin about the image.
pub struct Planes<'a> {
    colors: [&'a mut [f32]; 3],
    stride: usize,
    margin: usize,
}

impl<'a> Channels<'a> {
    /// Cuts the image into rows of tiles.
    pub fn bands(self, width: usize, count: usize) -> Vec<Channels<'a>> {
        fn cut<T>(
            channel: Option<&mut [T]>,
            length: usize,
        ) -> impl Iterator<Item = Option<&mut [T]>> {
            let mut rest = channel.map(|c| c.chunks_mut(length));
            std::iter::from_fn(move || Some(rest.as_mut().and_then(Iterator::next)))
        }
        let n = width * TILE;
        let (mut rgb, mut radiance) = (cut(self.rgb, n * 3), cut(self.radiance, n * 3));
        let mut planes = self.planes.map(Planes::bands);
        let (mut depth, mut ray_distance) = (cut(self.depth, n), cut(self.ray_distance, n));
        let (mut normal, mut position) = (cut(self.normal, n * 3), cut(self.position, n * 3));
        let (mut label, mut instance) = (cut(self.label, n), cut(self.instance, n));
        let (mut albedo, mut arc_length) = (cut(self.albedo, n * 3), cut(self.arc_length, n));
        let (mut face, mut weights) = (cut(self.face, n), cut(self.weights, n * 2));
        let (mut foreground_label, mut foreground_depth) =
            (cut(self.foreground_label, n), cut(self.foreground_depth, n));
        let mut foreground_instance = cut(self.foreground_instance, n);
        let mut refraction_label = cut(self.refraction_label, n);
        let s = sparse(width) * TILE / STEP;
        let mut sparse_position = cut(self.sparse_position, s * 3);
        let (mut sparse_face, mut sparse_weights) =
            (cut(self.sparse_face, s), cut(self.sparse_weights, s * 2));
        let mut sparse_refraction = cut(self.sparse_refraction, s);
        (0..count)
            .map(|_| Channels {
                rgb: rgb.next().flatten(),
                radiance: radiance.next().flatten(),
                planes: planes.as_mut().and_then(Iterator::next),
                depth: depth.next().flatten(),
                ray_distance: ray_distance.next().flatten(),
                normal: normal.next().flatten(),
                label: label.next().flatten(),
                instance: instance.next().flatten(),
                albedo: albedo.next().flatten(),
                arc_length: arc_length.next().flatten(),
                position: position.next().flatten(),
                face: face.next().flatten(),
                weights: weights.next().flatten(),
                sparse_position: sparse_position.next().flatten(),
                sparse_face: sparse_face.next().flatten(),
                sparse_weights: sparse_weights.next().flatten(),
                sparse_refraction: sparse_refraction.next().flatten(),
                foreground_label: foreground_label.next().flatten(),
                foreground_instance: foreground_instance.next().flatten(),
                foreground_depth: foreground_depth.next().flatten(),
                refraction_label: refraction_label.next().flatten(),
            })
            .collect()
    }

    /// Whether an image is to be made.
    pub fn wants_light(&self) -> bool {
        self.rgb.is_some() || self.radiance.is_some() || self.planes.is_some()
    }

    /// Whether surfaces are to be known that an image needs.
    pub fn wants_color(&self) -> bool {
        self.wants_light() || self.albedo.is_some()
    }
}

impl<'a> Planes<'a> {
    /// Of an array [3 h+2m w'] about an image of a height, where w' is w + 2m or more.
    ///
    /// # Errors
    /// If it is of another shape.
    pub fn of(
        array: &'a mut Option<PyReadwriteArrayDyn<'_, f32>>,
        (height, width): (usize, usize),
    ) -> PyResult<Option<Self>> {
        let Some(array) = array else { return Ok(None) };
        let around = |rows: usize| rows.checked_sub(height).filter(|around| around % 2 == 0);
        let (rows, stride, margin) = match *array.shape() {
            [3, rows, stride] if around(rows).is_some_and(|around| stride >= width + around) => {
                (rows, stride, (rows - height) / 2)
            }
            _ => return Err(wrong_shape("radiance_planar")),
        };
        let (red, rest) = array.as_slice_mut()?.split_at_mut(rows * stride);
        let (green, blue) = rest.split_at_mut(rows * stride);
        Ok(Some(Planes { colors: [red, green, blue], stride, margin }))
    }

    /// Rows of tiles.
    fn bands(self) -> impl Iterator<Item = Planes<'a>> {
        let Planes { colors, stride, margin } = self;
        let mut rest = colors.map(|plane| plane[margin * stride..].chunks_mut(TILE * stride));
        std::iter::repeat_with(move || {
            let colors = rest.each_mut().map(|plane| plane.next().unwrap_or_default());
            Planes { colors, stride, margin }
        })
    }
}

/// A channel of a dictionary of a shape, if it is there.
pub fn take<'py, T: Element>(
    out: &Bound<'py, PyDict>,
    name: &str,
    (height, width): (usize, usize),
    components: usize,
) -> PyResult<Option<PyReadwriteArrayDyn<'py, T>>> {
    let array = find(out, name)?;
    if array.as_ref().is_some_and(|array| array.len() != height * width * components) {
        return Err(wrong_shape(name));
    }
    Ok(array)
}

fn wrong_shape(name: &str) -> PyErr {
    PyValueError::new_err(format!("Channel {name} has the wrong shape."))
}

/// A channel of a dictionary, if it is there.
pub fn find<'py, T: Element>(
    out: &Bound<'py, PyDict>,
    name: &str,
) -> PyResult<Option<PyReadwriteArrayDyn<'py, T>>> {
    let Some(value) = out.get_item(name)? else {
        return Ok(None);
    };
    let array = value
        .cast::<PyArrayDyn<T>>()
        .map_err(|_| PyValueError::new_err(format!("Channel {name} has the wrong dtype.")))?;
    Ok(Some(array.try_readwrite()?))
}

/// Its numbers.
pub fn slice<'a, T: Element>(
    array: &'a mut Option<PyReadwriteArrayDyn<'_, T>>,
) -> PyResult<Option<&'a mut [T]>> {
    array.as_mut().map(|a| a.as_slice_mut().map_err(PyErr::from)).transpose()
}

/// Where a tile lies in its band.
#[derive(Clone, Copy)]
pub struct Place {
    pub column: usize,
    /// Width and height of the band [pixels].
    pub size: (usize, usize),
}

impl Place {
    #[inline(always)]
    pub fn write_each<T: Copy>(
        self,
        channel: &mut Option<&mut [T]>,
        components: usize,
        value: impl Fn(usize, usize) -> T,
    ) {
        let Some(pixels) = channel else { return };
        let (width, height) = self.size;
        let columns = (width - self.column).min(TILE);
        for y in 0..height {
            let start = (y * width + self.column) * components;
            let row = &mut pixels[start..start + columns * components];
            for (x, pixel) in row.chunks_exact_mut(components).enumerate() {
                fill(pixel, |k| value(y * TILE + x, k));
            }
        }
    }

    /// Writes the pixels that stand for all others.
    #[inline(always)]
    pub fn write_sparsely<T: Copy>(
        self,
        channel: &mut Option<&mut [T]>,
        components: usize,
        value: impl Fn(usize, usize) -> T,
    ) {
        let Some(pixels) = channel else { return };
        let (width, height) = self.size;
        for y in (STEP / 2..height).step_by(STEP) {
            for x in (STEP / 2..(width - self.column).min(TILE)).step_by(STEP) {
                let place = y / STEP * sparse(width) + (self.column + x) / STEP;
                fill(&mut pixels[place * components..][..components], |k| value(y * TILE + x, k));
            }
        }
    }

    #[inline(always)]
    pub fn write<T: Copy>(
        self,
        channel: &mut Option<&mut [T]>,
        values: &[T; LANES],
        hit: &[bool; LANES],
        miss: T,
    ) {
        if let Some(pixels) = channel {
            self.put(pixels, self.size.0, values, hit, miss);
        }
    }

    /// Writes pixels of rows that are so many apart.
    #[inline(always)]
    fn put<T: Copy>(
        self,
        pixels: &mut [T],
        stride: usize,
        values: &[T; LANES],
        hit: &[bool; LANES],
        miss: T,
    ) {
        let mut known = [miss; LANES];
        for i in 0..LANES {
            known[i] = if hit[i] { values[i] } else { miss };
        }
        let (width, height) = self.size;
        let columns = (width - self.column).min(TILE);
        for (y, row) in known.as_chunks::<TILE>().0.iter().take(height).enumerate() {
            let start = y * stride + self.column;
            store(row, &mut pixels[start..start + columns]);
        }
    }

    #[inline(always)]
    pub fn write3(
        self,
        channel: &mut Option<&mut [f32]>,
        values: &Lane3,
        hit: &[bool; LANES],
        miss: f32,
    ) {
        if channel.is_none() {
            return;
        }
        let mut known = [[miss; LANES]; 3];
        for k in 0..3 {
            for i in 0..LANES {
                known[k][i] = if hit[i] { values[k][i] } else { miss };
            }
        }
        self.write_each(channel, 3, |i, k| known[k][i]);
    }

    /// Radiance in every form that it is asked for in.
    #[inline(always)]
    pub fn write_light(
        self,
        out: &mut Channels<'_>,
        radiance: &Lane3,
        hit: &[bool; LANES],
        exposure: f32,
    ) {
        self.write_color(&mut out.rgb, radiance, exposure);
        self.write3(&mut out.radiance, radiance, hit, 0.0);
        if let Some(Planes { colors, stride, margin }) = &mut out.planes {
            for (plane, values) in colors.iter_mut().zip(radiance) {
                self.put(&mut plane[*margin..], *stride, values, hit, 0.0);
            }
        }
    }

    #[inline(always)]
    fn write_color(self, channel: &mut Option<&mut [u8]>, radiance: &Lane3, exposure: f32) {
        if channel.is_none() {
            return;
        }
        let mut encoded = [[0u8; LANES]; 3];
        for k in 0..3 {
            for i in 0..LANES {
                encoded[k][i] = srgb(radiance[k][i] * exposure);
            }
        }
        self.write_each(channel, 3, |i, k| encoded[k][i]);
    }
}

/// Writes each component of a pixel.
#[inline(always)]
fn fill<T>(pixel: &mut [T], value: impl Fn(usize) -> T) {
    for (k, out) in pixel.iter_mut().enumerate() {
        *out = value(k);
    }
}

/// 8-bit sRGB of a linear value (IEC 61966-2-1), rounded to nearest.
#[inline(always)]
pub fn srgb(linear: f32) -> u8 {
    let x = clamp(linear, 0.0, 1.0);
    let curve = 1.055 * pow(x, 1.0 / 2.4) - 0.055;
    let encoded = if x <= 0.003_130_8 { 12.92 * x } else { curve };
    // Adding 2²³ rounds to a whole number and leaves it in the low bits.
    (encoded * 255.0 + 8_388_608.0).to_bits() as u8
}

/// 8-bit sRGB image [h w 3] of linear radiance [h w 3] times `exposure`.
#[pyfunction]
pub fn encode_srgb<'py>(
    py: Python<'py>,
    radiance: numpy::PyReadonlyArray3<'py, f32>,
    exposure: f32,
) -> Bound<'py, numpy::PyArray3<u8>> {
    use numpy::ToPyArray;
    radiance.as_array().mapv(|x| srgb(x * exposure)).to_pyarray(py)
}
