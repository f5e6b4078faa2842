//! Registry of stages: constant parameters and parameters of each frame.

use super::dome::{GivenDrops, GivenSmears};
use super::isp::Matrix;
use super::optical_flow::GivenPoints;
use super::sensor_noise::{GivenSensor, Readout};
use numpy::{Element, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};

/// Declares a struct of the parameters of stages by name; those that are off are `None`.
macro_rules! stages {
    ($(#[$about:meta])* $kind:ident { $($(#[$doc:meta])* $stage:ident: $params:ty,)* }) => {
        $(#[$about])*
        #[derive(Default)]
        pub struct $kind<'py> { $($(#[$doc])* pub $stage: Option<$params>,)* }

        impl<'py> $kind<'py> {
            /// Reads parameters from a dictionary by name.
            ///
            /// # Errors
            /// If a stage does not exist, or its parameters have another type.
            pub fn of(given: &Bound<'py, PyDict>) -> PyResult<Self> {
                let mut found = Self::default();
                for (name, params) in given.iter() {
                    match name.extract::<String>()?.as_str() {
                        $(stringify!($stage) => {
                            found.$stage = Some(params.extract::<$params>()?);
                        })*
                        name => return Err(PyValueError::new_err(format!("No stage {name}."))),
                    }
                }
                Ok(found)
            }
        }
    };
}

stages! {
    /// Constant parameters, by stage in their order.
    StageParams {
        /// Exposure time of each row, and duration of the LED pulse [frames].
        motion_blur: (f32, f32),
        /// Time from the first row's exposure to the last one's [frames].
        rolling_shutter: f32,
        /// Radius per change of inverse distance [px·m] and focus distance [m].
        depth_of_field: (f32, f32),
        smears: GivenSmears<'py>,
        /// Center (column, row) [px], and the scale of each color.
        chromatic_aberration: ([f32; 2], [f32; 3]),
        /// Fraction of the light that each pixel receives [h w].
        vignetting: PyReadonlyArray2<'py, f32>,
        /// Scattered fraction and standard deviation [px].
        bloom: (f32, f32),
        sensor_noise: GivenSensor<'py>,
        /// Colors of 2 × 2 sites.
        bayer_filter: [usize; 4],
        /// Gain and response of each color.
        white_balance: ([f64; 3], [f64; 3]),
        /// Matrix of linear colors.
        color_matrix: Matrix,
        /// Exponent and factor, see `isp::encode_row`.
        tone_curve: (f32, f32),
        /// Standard deviations for luma and chroma [px].
        denoising: (f32, f32),
        /// Amount, standard deviation [px] and threshold [1/255 of white].
        sharpening: (f32, f32, f32),
        /// Quality, and maximum file size [bytes].
        jpeg: (u32, Option<usize>),
    }
}

stages! {
    /// Parameters of a frame, by stage.
    FrameStageParams {
        depth_of_field: Distance<'py>,
        droplets: GivenDrops<'py>,
        /// Light of the LEDs relative to the camera's own, and gain.
        auto_exposure: (f64, f64),
    }
}

/// Distance along the ray to the wall [m], label and depth [m] of the foreground.
pub type Distance<'py> =
    (PyReadonlyArray2<'py, f32>, PyReadonlyArray2<'py, u8>, PyReadonlyArray2<'py, f32>);

/// `Distance` in the order wall, depth, label.
pub type Distances<'a> = (&'a [f32], &'a [f32], &'a [u8]);

/// Parameters of one frame.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct FrameParams<'py> {
    /// Factor from radiance to image values.
    pub exposure: f32,
    /// Positions of moving points in a neighboring frame; None if nothing moves.
    pub points: Option<GivenPoints<'py>>,
    /// True if that is the previous frame.
    pub is_backward: bool,
    /// Parameters for `FrameStageParams`.
    pub stages: Bound<'py, PyDict>,
    /// Key of the random numbers.
    pub key: (u64, u64),
}

impl StageParams<'_> {
    /// Times of the shutter in frames: open, readout, pulse; `None` for an instantaneous exposure.
    pub fn shutter(&self) -> Option<(f32, f32, f32)> {
        if self.motion_blur.is_none() && self.rolling_shutter.is_none() {
            return None;
        }
        let (open, pulse) = self.motion_blur.unwrap_or((0.0, f32::INFINITY));
        Some((open, self.rolling_shutter.unwrap_or(0.0), pulse))
    }
}

impl FrameStageParams<'_> {
    /// Distances of an image of the given size.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn distances(&self, size: (usize, usize)) -> PyResult<Option<Distances<'_>>> {
        let Some((wall, label, depth)) = &self.depth_of_field else { return Ok(None) };
        Ok(Some((of_image(wall, size)?, of_image(depth, size)?, of_image(label, size)?)))
    }

    /// Readout of the sensor, if there is one, and gains after it, from the constant parameters.
    pub fn readout(
        &self,
        sensor: Option<Readout>,
        colors: ColorGains,
    ) -> (Option<Readout>, [f32; 3]) {
        let (light, gain) = self.auto_exposure.unwrap_or((1.0, 1.0));
        let after = if sensor.is_some() { 1.0 } else { light * gain };
        let read = sensor.map(|sensor| Readout {
            light: light as f32,
            gain: gain as f32,
            response: colors.1.map(|x| x as f32),
            ..sensor
        });
        (read, colors.0.map(|x| (after * x) as f32))
    }
}

/// Gain and response of each color.
pub type ColorGains = ([f64; 3], [f64; 3]);

/// Returns an array of the image's size as a slice.
pub fn of_image<'a, T: Element>(
    array: &'a PyReadonlyArray2<'_, T>,
    (height, width): (usize, usize),
) -> PyResult<&'a [T]> {
    if array.shape() != [height, width] {
        return Err(size_mismatch());
    }
    Ok(array.as_slice()?)
}

/// Error for stages and images of different sizes.
pub fn size_mismatch() -> PyErr {
    PyValueError::new_err("Stages and images must be of one size.")
}
