//! Arrays of an image that tiles write into.

use crate::simd::f32x64::*;
use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};

/// Stride of the subsampled pixel grid, which starts in the middle of a cell.
pub const STEP: usize = 4;

/// Number of pixels of the subsampled grid in a row of `size` pixels.
fn subsampled(size: usize) -> usize {
    (size + STEP / 2 - 1) / STEP
}

/// Declares the channels, one line each: `name: type x components`. Generates the arrays borrowed
/// from Python, `Channels` and the division of an image into bands of tiles.
///
/// `full` channels hold every pixel, `subsampled` ones the pixels of a grid of stride `STEP`.
macro_rules! channels {
    (
        full { $($name:ident: $type:ty, $components:literal;)* }
        subsampled { $($few:ident: $few_type:ty, $few_components:literal;)* }
    ) => {
        /// Channels of an image, or of a row of its tiles; `None` if not requested.
        #[derive(Default)]
        pub struct Channels<'a> {
            $(pub $name: Option<&'a mut [$type]>,)*
            $(pub $few: Option<&'a mut [$few_type]>,)*
            pub planes: Option<Planes<'a>>,
        }

        /// Channels as NumPy arrays.
        pub struct ChannelArrays<'py> {
            shape: (usize, usize),
            $($name: Option<PyReadwriteArrayDyn<'py, $type>>,)*
            $($few: Option<PyReadwriteArrayDyn<'py, $few_type>>,)*
            planes: Option<PyReadwriteArrayDyn<'py, f32>>,
        }

        impl<'py> ChannelArrays<'py> {
            /// Borrows the arrays of a dictionary for an image of the given height and width.
            ///
            /// # Errors
            /// If an array has the wrong type or shape.
            pub fn borrow(out: &Bound<'py, PyDict>, shape: (usize, usize)) -> PyResult<Self> {
                let few = (subsampled(shape.0), subsampled(shape.1));
                Ok(ChannelArrays {
                    shape,
                    $($name: take(out, stringify!($name), shape, $components)?,)*
                    $($few: take(out, stringify!($few), few, $few_components)?,)*
                    planes: find(out, "radiance_planar")?,
                })
            }

            /// Returns the arrays as slices.
            pub fn channels(&mut self) -> PyResult<Channels<'_>> {
                Ok(Channels {
                    $($name: slice(&mut self.$name)?,)*
                    $($few: slice(&mut self.$few)?,)*
                    planes: Planes::of(&mut self.planes, self.shape)?,
                })
            }
        }

        impl<'a> Channels<'a> {
            /// Splits the image into rows of tiles.
            pub fn bands(self, width: usize, count: usize) -> Vec<Channels<'a>> {
                self.pieces(width * TILE, subsampled(width) * TILE / STEP, count)
            }

            /// Splits vertically stacked images of `pixels` pixels each into single images;
            /// excludes subsampled channels and planes.
            pub fn images(self, pixels: usize, count: usize) -> Vec<Channels<'a>> {
                self.pieces(pixels, 1, count)
            }

            /// Splits into pieces of `all` pixels of the image and `few` of the subsampled grid.
            fn pieces(self, all: usize, few: usize, count: usize) -> Vec<Channels<'a>> {
                $(let mut $name = cut(self.$name, all * $components);)*
                $(let mut $few = cut(self.$few, few * $few_components);)*
                let mut planes = self.planes.map(Planes::bands);
                (0..count)
                    .map(|_| Channels {
                        $($name: $name.next().flatten(),)*
                        $($few: $few.next().flatten(),)*
                        planes: planes.as_mut().and_then(Iterator::next),
                    })
                    .collect()
            }
        }
    };
}

channels! {
    full {
        rgb: u8, 3;
        radiance: f32, 3;
        depth: f32, 1;
        ray_distance: f32, 1;
        normal: f32, 3;
        label: u8, 1;
        instance: u16, 1;
        albedo: f32, 3;
        arc_length: f32, 1;
        position: f32, 3;
        face: i32, 1;
        weights: f32, 2;
        foreground_label: u8, 1;
        foreground_instance: u16, 1;
        foreground_depth: f32, 1;
        refraction_label: u8, 1;
    }
    subsampled {
        sparse_position: f32, 3;
        sparse_face: i32, 1;
        sparse_weights: f32, 2;
        sparse_refraction: u8, 1;
    }
}

/// Checks that all arrays hold every pixel of an image.
///
/// # Errors
/// If an array is subsampled or planar.
pub fn refuse_partial(out: &Bound<'_, PyDict>) -> PyResult<()> {
    for name in out.keys() {
        let name: String = name.extract()?;
        if name.starts_with("sparse_") || name == "radiance_planar" {
            return Err(PyValueError::new_err(format!(
                "Channel {name} is not available for several images."
            )));
        }
    }
    Ok(())
}

/// Splits a channel into pieces of a length; infinite, because absent channels have no end.
fn cut<T>(channel: Option<&mut [T]>, length: usize) -> impl Iterator<Item = Option<&mut [T]>> {
    let mut rest = channel.map(|c| c.chunks_mut(length));
    std::iter::from_fn(move || Some(rest.as_mut().and_then(Iterator::next)))
}

/// Radiance as one plane per color, with a margin around the image.
pub struct Planes<'a> {
    colors: [&'a mut [f32]; 3],
    stride: usize,
    margin: usize,
}

impl Channels<'_> {
    /// True if radiance or an image is requested.
    pub fn wants_light(&self) -> bool {
        self.rgb.is_some() || self.radiance.is_some() || self.planes.is_some()
    }

    /// True if the surface material is needed.
    pub fn wants_color(&self) -> bool {
        self.wants_light() || self.albedo.is_some()
    }
}

impl<'a> Planes<'a> {
    /// Planes of an array [3 h+2m w'] around an image of size [h w], where w' ≥ w + 2m.
    ///
    /// # Errors
    /// If the array has another shape.
    fn of(
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

    /// Splits the planes into rows of tiles.
    fn bands(self) -> impl Iterator<Item = Planes<'a>> {
        let Planes { colors, stride, margin } = self;
        let mut rest = colors.map(|plane| plane[margin * stride..].chunks_mut(TILE * stride));
        std::iter::repeat_with(move || {
            let colors = rest.each_mut().map(|plane| plane.next().unwrap_or_default());
            Planes { colors, stride, margin }
        })
    }
}

/// Borrows a channel of the given shape from a dictionary, if present.
fn take<'py, T: Element>(
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

/// Borrows a channel from a dictionary, if present.
fn find<'py, T: Element>(
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

/// Returns the array as a slice.
fn slice<'a, T: Element>(
    array: &'a mut Option<PyReadwriteArrayDyn<'_, T>>,
) -> PyResult<Option<&'a mut [T]>> {
    array.as_mut().map(|a| a.as_slice_mut().map_err(PyErr::from)).transpose()
}

/// Position of a tile in its band.
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

    /// Writes the pixels of the subsampled grid.
    #[inline(always)]
    pub fn write_subsampled<T: Copy>(
        self,
        channel: &mut Option<&mut [T]>,
        components: usize,
        value: impl Fn(usize, usize) -> T,
    ) {
        let Some(pixels) = channel else { return };
        let (width, height) = self.size;
        for y in (STEP / 2..height).step_by(STEP) {
            for x in (STEP / 2..(width - self.column).min(TILE)).step_by(STEP) {
                let place = y / STEP * subsampled(width) + (self.column + x) / STEP;
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

    /// Writes pixels; `stride` is the distance between rows.
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

    /// Writes radiance to every requested channel.
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

/// sRGB encoding of a linear value (IEC 61966-2-1), 0 to 1.
#[inline(always)]
pub fn encode(linear: f32) -> f32 {
    let x = clamp(linear, 0.0, 1.0);
    let curve = 1.055 * pow(x, 1.0 / 2.4) - 0.055;
    if x <= 0.003_130_8 { 12.92 * x } else { curve }
}

/// 8-bit sRGB of a linear value, rounded to nearest.
#[inline(always)]
pub fn srgb(linear: f32) -> u8 {
    // Adding 2²³ rounds to a whole number and leaves it in the low bits.
    (encode(linear) * 255.0 + 8_388_608.0).to_bits() as u8
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
