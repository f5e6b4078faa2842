//! What the stages of one camera are given: once, and with each frame.

use super::dome::{GivenDrops, GivenFilm};
use super::flow::GivenPoints;
use super::noise::Readout;
use crate::render::ray_table::RayTable;
use numpy::{Element, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Stages that stay as they are from frame to frame; those that are off are `None`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Given<'py> {
    pub rays: Py<RayTable>,
    /// Pixels that see anything [h w].
    pub lit: PyReadonlyArray2<'py, bool>,
    /// Cosine between each pixel's ray and the axis [h w].
    pub cosine: PyReadonlyArray2<'py, f32>,
    /// The times of `Shutter`, in its order.
    pub shutter: Option<(f32, f32, f32)>,
    /// Reach [px·m] and distance of focus [m].
    pub defocus: Option<(f32, f32)>,
    pub film: Option<GivenFilm<'py>>,
    /// Centre (column, row) [px], and the scale of each colour.
    pub scales: Option<([f32; 2], [f32; 3])>,
    /// Share of the light that each pixel gets [h w].
    pub shade: Option<PyReadonlyArray2<'py, f32>>,
    /// Share and standard deviation [px].
    pub bloom: Option<(f32, f32)>,
    /// Response and offset of the sensor's sites.
    pub pattern: [PyReadonlyArray2<'py, f32>; 2],
    pub mosaic: Option<[usize; 4]>,
    /// Quality, and limit of the file [bytes].
    pub jpeg: Option<(u32, Option<usize>)>,
}

/// Distance along the ray of the wall [m], label and depth [m] of what is in front of it.
pub type Distance<'py> =
    (PyReadonlyArray2<'py, f32>, PyReadonlyArray2<'py, u8>, PyReadonlyArray2<'py, f32>);

/// The same in the order wall, depth, label.
pub type Distances<'a> = (&'a [f32], &'a [f32], &'a [u8]);

/// What changes from frame to frame.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Shot<'py> {
    /// From radiance to image values.
    pub factor: f32,
    /// What moves, if anything does, where it is in a neighbouring frame.
    pub points: Option<GivenPoints<'py>>,
    /// Whether that is the frame before.
    pub is_backward: bool,
    pub distance: Option<Distance<'py>>,
    pub drops: Option<GivenDrops<'py>>,
    /// None where the sensor changes nothing.
    pub readout: Option<Readout>,
    /// Gain of each colour after the sensor.
    pub gains: [f32; 3],
    /// Of the random numbers.
    pub key: (u64, u64),
}

impl Shot<'_> {
    /// What `distance` holds, of an image of a size.
    pub fn distance(&self, size: (usize, usize)) -> PyResult<Option<Distances<'_>>> {
        let Some((wall, label, depth)) = &self.distance else { return Ok(None) };
        Ok(Some((of_image(wall, size)?, of_image(depth, size)?, of_image(label, size)?)))
    }
}

/// The numbers of an array of the image's size.
pub fn of_image<'a, T: Element>(
    array: &'a PyReadonlyArray2<'_, T>,
    (height, width): (usize, usize),
) -> PyResult<&'a [T]> {
    if array.shape() != [height, width] {
        return Err(misfit());
    }
    Ok(array.as_slice()?)
}

/// What stages say that are not of one size.
pub fn misfit() -> PyErr {
    PyValueError::new_err("Stages and images must be of one size.")
}
