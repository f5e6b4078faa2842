//! PNG files: written in parallel and atomically, read back exactly.

use crate::pool::{detached, map};
use numpy::{
    IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArrayDyn,
    PyUntypedArrayMethods,
    ndarray::{ArrayD, IxDyn},
};
use png::{BitDepth, ColorType};
use pyo3::{
    exceptions::{PyOSError, PyValueError},
    prelude::*,
    types::PyBytes,
};
use rayon::prelude::*;
use std::{
    fs::{self, File},
    hash::{BuildHasher, Hasher, RandomState},
    io::{self, Write},
    path::Path,
};

/// Image in PNG's layout: 16-bit numbers with the high byte first.
struct Image {
    width: u32,
    height: u32,
    color: ColorType,
    depth: BitDepth,
    bytes: Vec<u8>,
}

impl Image {
    fn new(array: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (shape, bytes, depth) = if let Ok(a) = array.cast::<PyArrayDyn<u8>>() {
            let view = a.try_readonly()?;
            let bytes = view.as_array().as_standard_layout().as_slice().unwrap_or(&[]).to_vec();
            (a.shape().to_vec(), bytes, BitDepth::Eight)
        } else if let Ok(a) = array.cast::<PyArrayDyn<u16>>() {
            let view = a.try_readonly()?;
            let bytes = big_endian(view.as_array().as_standard_layout().as_slice().unwrap_or(&[]));
            (a.shape().to_vec(), bytes, BitDepth::Sixteen)
        } else {
            return Err(PyValueError::new_err("Images must be uint8 or uint16."));
        };
        let color = match shape[..] {
            [_, _] => ColorType::Grayscale,
            [_, _, 3] => ColorType::Rgb,
            _ => {
                return Err(PyValueError::new_err("Images must be of shape (h, w) or (h, w, 3)."));
            }
        };
        Ok(Image { width: shape[1] as u32, height: shape[0] as u32, color, depth, bytes })
    }

    fn encode(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut file = Vec::with_capacity(self.bytes.len() / 2 + 1024);
        let mut encoder = png::Encoder::new(&mut file, self.width, self.height);
        encoder.set_color(self.color);
        encoder.set_depth(self.depth);
        // Slower settings take over 10 times as long for a seventh less
        // (docs/concepts/datasets.md).
        encoder.set_compression(png::Compression::Fast);
        encoder.set_filter(png::Filter::Paeth);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.bytes)?;
        writer.finish()?;
        Ok(file)
    }
}

/// Bytes of 16-bit numbers, the high one first.
fn big_endian(numbers: &[u16]) -> Vec<u8> {
    let mut bytes = vec![0; 2 * numbers.len()];
    for (pair, number) in bytes.as_chunks_mut().0.iter_mut().zip(numbers) {
        *pair = number.to_be_bytes();
    }
    bytes
}

const ATTEMPTS: usize = 3;

/// Writes a file atomically: to the disk under a unique temporary name, then renames it.
fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut written = Ok(());
    for _ in 0..ATTEMPTS {
        let unique = RandomState::new().build_hasher().finish(); // the system seeds each one
        let temporary = path.with_file_name(format!(".{name}.{unique:016x}.tmp"));
        written = write_and_rename(&temporary, path, bytes);
        match &written {
            // `temporary_files.remove_stale` of another process came before the lock.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(_) => {
                // Keeps the first error; a temporary file may not even exist.
                let _ = fs::remove_file(&temporary);
                break;
            }
            Ok(()) => break,
        }
    }
    written
}

/// Writes a file, locked as one of a running process, and renames it once it is on the disk.
fn write_and_rename(temporary: &Path, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(temporary)?;
    if cfg!(unix) {
        let _ = file.try_lock(); // some file systems have no locks
    }
    file.write_all(bytes)?;
    file.sync_data()?; // with the length, but without the time
    fs::rename(temporary, path)
}

fn os_error(path: &str, error: &io::Error) -> PyErr {
    match error.raw_os_error() {
        Some(number) => {
            let text = error.to_string();
            let text = text.split(" (os error").next().unwrap_or(&text).to_owned();
            PyOSError::new_err((number, text, path.to_owned()))
        }
        None => PyOSError::new_err(format!("{path}: {error}")),
    }
}

/// Value 2²³, from which on floats are integers.
const WHOLE: f32 = 8_388_608.0;

/// Quantizes a float image to 16 bits: round((value − offset) / scale), 0 where any component of
/// the pixel is NaN or outside 1 to 65535.
///
/// `values` is of shape (h, w) or (h, w, components) and C-contiguous.
#[pyfunction]
pub fn quantize<'py>(
    py: Python<'py>,
    values: PyReadonlyArrayDyn<'py, f32>,
    scale: f32,
    offset: f32,
) -> PyResult<Bound<'py, PyArrayDyn<u16>>> {
    let shape = values.shape().to_vec();
    let components = shape.get(2).copied().unwrap_or(1).max(1);
    let pixels = values.as_slice()?;
    let mut steps = vec![0u16; pixels.len()];
    let per_unit = 1.0 / scale;
    let rows = shape.get(1).copied().unwrap_or(1).max(1) * components * 16;
    detached(py, || {
        steps.par_chunks_mut(rows).zip(pixels.par_chunks(rows)).for_each(|(out, row)| {
            for (step, &value) in out.iter_mut().zip(row) {
                // Integers of 0 to 2²³ are then in the low bits, ties rounded to even.
                let shifted = (value - offset) * per_unit + WHOLE;
                let is_valid = (WHOLE + 1.0..=WHOLE + 65535.0).contains(&shifted);
                *step = if is_valid { shifted.to_bits() as u16 } else { 0 };
            }
            for pixel in out.chunks_exact_mut(components).filter(|p| p.contains(&0)) {
                pixel.fill(0);
            }
        });
    });
    let array = ArrayD::from_shape_vec(IxDyn(&shape), steps);
    Ok(array.map_err(|e| PyValueError::new_err(e.to_string()))?.into_pyarray(py))
}

/// Writes PNG files, encoded in parallel, each atomically.
///
/// The calling thread writes them, so that threads of the render pool never wait for a disk.
///
/// `items` holds paths and arrays of uint8 or uint16, of shape (h, w) or (h, w, 3).
#[pyfunction]
pub fn write_pngs(py: Python<'_>, items: Vec<(String, Bound<'_, PyAny>)>) -> PyResult<()> {
    let image = |(path, array): (String, Bound<'_, PyAny>)| match Image::new(&array) {
        Ok(image) => Ok((path, image)),
        Err(e) => Err(PyValueError::new_err(format!("{path}: {}", e.value(py)))),
    };
    let images: Vec<(String, Image)> = items.into_iter().map(image).collect::<PyResult<_>>()?;
    let files = map(py, &images, 1, |(_, image)| image.encode());
    py.detach(|| {
        for ((path, _), file) in images.iter().zip(files) {
            let written =
                file.map_err(io::Error::other).and_then(|f| write_whole(Path::new(path), &f));
            written.map_err(|e| os_error(path, &e))?;
        }
        Ok(())
    })
}

/// Encodes arrays of uint8 or uint16, of shape (h, w) or (h, w, 3), as PNG files, in parallel.
#[pyfunction]
pub fn encode_pngs<'py>(
    py: Python<'py>,
    arrays: Vec<Bound<'py, PyAny>>,
) -> PyResult<Vec<Bound<'py, PyBytes>>> {
    let images: Vec<Image> = arrays.iter().map(Image::new).collect::<PyResult<_>>()?;
    let files = map(py, &images, 1, Image::encode).into_iter().collect::<Result<Vec<_>, _>>();
    let files = files.map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok(files.iter().map(|file| PyBytes::new(py, file)).collect())
}

/// Reads a PNG file of 8 or 16 bits, gray or RGB, as it is stored.
#[pyfunction]
pub fn read_png<'py>(py: Python<'py>, path: String) -> PyResult<Bound<'py, PyAny>> {
    let bytes = fs::read(&path).map_err(|e| os_error(&path, &e))?;
    let array = py.detach(|| decode(&bytes)).and_then(|pixels| pixels.into_array(py));
    array.map_err(|e| PyValueError::new_err(format!("{path}: {e}")))
}

/// Decodes PNG files of 8 or 16 bits, gray or RGB, each given as uint8, in parallel.
#[pyfunction]
pub fn decode_pngs<'py>(
    py: Python<'py>,
    files: Vec<PyReadonlyArray1<'py, u8>>,
) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let files: Vec<&[u8]> = files.iter().map(|file| file.as_slice()).collect::<Result<_, _>>()?;
    let images = map(py, &files, 1, |file| decode(file));
    let arrays = images.into_iter().map(|image| image?.into_array(py));
    arrays.collect::<Result<_, _>>().map_err(PyValueError::new_err::<String>)
}

/// Pixel values of an image and its shape.
struct Pixels {
    shape: Vec<usize>,
    is_wide: bool,
    bytes: Vec<u8>,
}

impl Pixels {
    fn into_array(self, py: Python<'_>) -> Result<Bound<'_, PyAny>, String> {
        let shape = IxDyn(&self.shape);
        if self.is_wide {
            let wide = |b: &[u8; 2]| u16::from_be_bytes(*b);
            let numbers = self.bytes.as_chunks().0.iter().map(wide).collect();
            let array = ArrayD::from_shape_vec(shape, numbers);
            Ok(array.map_err(|e| e.to_string())?.into_pyarray(py).into_any())
        } else {
            let array = ArrayD::from_shape_vec(shape, self.bytes);
            Ok(array.map_err(|e| e.to_string())?.into_pyarray(py).into_any())
        }
    }
}

fn decode(bytes: &[u8]) -> Result<Pixels, String> {
    let (info, bytes) = unpack(bytes)?;
    let (height, width) = (info.height as usize, info.width as usize);
    let shape = match info.color_type {
        ColorType::Grayscale => vec![height, width],
        ColorType::Rgb => vec![height, width, 3],
        other => return Err(format!("unexpected color type {other:?}.")),
    };
    Ok(Pixels { shape, is_wide: info.bit_depth == BitDepth::Sixteen, bytes })
}

/// Maximum number of bytes per byte of deflate (zlib's technical notes: 1032).
const MOST_EXPANSION: usize = 1040;

fn unpack(bytes: &[u8]) -> Result<(png::OutputInfo, Vec<u8>), String> {
    let decoder = png::Decoder::new(io::Cursor::new(bytes));
    let mut reader = decoder.read_info().map_err(|e| e.to_string())?;
    let size = reader.output_buffer_size().unwrap_or(usize::MAX);
    if size > bytes.len().saturating_mul(MOST_EXPANSION) {
        let (width, height) = reader.info().size();
        return Err(format!("{} bytes cannot hold {width} by {height} pixels", bytes.len()));
    }
    let mut pixels = vec![0; size];
    let info = reader.next_frame(&mut pixels).map_err(|e| e.to_string())?;
    pixels.truncate(info.buffer_size());
    Ok((info, pixels))
}
