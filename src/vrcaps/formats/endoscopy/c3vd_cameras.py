"""Cameras of C3VD and of its readers.

``*_omnidirectional_values.txt`` holds ``width height cx cy a0 [a1] a2 a3 a4 c d e``: the
Scaramuzza model, a1 always 0. The data set's own loader counts pixels from 0 and uses
the stretch matrix [[c, d], [e, 1]]. Pinholes have ``*_pinhole_values.txt`` in the same
form, ``width height fx fy cx cy k1 k2 p1 p2 k3``. EndoGSLAM reads a YAML file, PPSNet
``camera.txt``, whose second to fifth words are fx fy cx cy.
"""

from __future__ import annotations

from pathlib import Path

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole, LensScaramuzza
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes
from vrcaps.core.units import MM
from vrcaps.formats.shared.intrinsics import nearest_file, read_text_numbers
from vrcaps.formats.shared.stored_images import image_size
from vrcaps.formats.shared.yaml_files import numbers_of, read_yaml

OMNIDIRECTIONAL, PINHOLE = "*omnidirectional_values.txt", "*pinhole_values.txt"
ENDOGSLAM, PPSNET = "c3vd.yaml", "camera.txt"
_NAMES = {
    OMNIDIRECTIONAL: "width height cx cy a0 a2 a3 a4 c d e",
    PINHOLE: "width height fx fy cx cy k1 k2 p1 p2 k3",
}
_FIT = (802.319, 801.885, 668.286, 547.733, -0.42234, 0.10654)
"""fx, fy, cx, cy [px], k1, k2 of C3VD's colonoscope at 1350x1080 (EndoGSLAM, undisort.py)."""
_FIT_SIZE = (1350, 1080)


def write_calibration(folder: Path, camera: Camera) -> None:
    """Write the lens of a camera as C3VD does, with a file that names the values."""
    lens = camera.lens
    if isinstance(lens, LensScaramuzza):
        kind = OMNIDIRECTIONAL
        numbers = [lens.cx, lens.cy, lens.a0, lens.a2, lens.a3, lens.a4, lens.c, lens.d, lens.e]
    else:
        assert isinstance(lens, LensPinhole)
        kind = PINHOLE
        numbers = [lens.fx, lens.fy, lens.cx, lens.cy, lens.k1, lens.k2]
        numbers += [lens.p1, lens.p2, lens.k3]
    path = folder / kind.replace("*", "camera_")
    row = " ".join(f"{value:.17g}" for value in (camera.width, camera.height, *numbers))
    write_bytes(path, f"{row}\n".encode())
    names = f"{_NAMES[kind]}\n".encode()
    write_bytes(path.with_name(path.name.replace("values", "format")), names)


def read_calibration(folder: Path, top: Path, image: Path) -> Camera | None:
    """Camera of the nearest calibration in a sequence's folder or above; None if there is none.

    InputError: If it cannot be read, or is for another image size.
        InputError: If it cannot be read, or is of images of another size.
    """
    path = nearest_file(folder, top, OMNIDIRECTIONAL, PINHOLE)
    if path is None:
        return None
    width, height, *values = read_text_numbers(path) or (0.0, 0.0)
    if len(values) == 10 and values[3] == 0.0:
        del values[3]  # a1
    if len(values) != 9:
        names = _NAMES[PINHOLE if path.match(PINHOLE) else OMNIDIRECTIONAL]
        raise InputError(f"{path} holds {2 + len(values)} numbers. Allowed: {names}.")
    if (height, width) != image_size(image):
        rows, columns = image_size(image)
        raise InputError(
            f"{path} is of images of {width:g}x{height:g} pixels, but {image} has "
            f"{columns}x{rows}. Give a calibration of that size, or take it away."
        )
    return Camera("camera", _lens(path, values), int(width), int(height))


def _lens(path: Path, values: list[float]) -> LensScaramuzza | LensPinhole:
    if path.match(PINHOLE):
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = values
        return LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
    cx, cy, a0, a2, a3, a4, c, d, e = values
    return LensScaramuzza(a0, a2, a3, a4, cx=cx, cy=cy, c=c, d=d, e=e)


def fitted_camera(image: Path, *, is_undistorted: bool) -> Camera:
    """Pinhole camera that EndoGSLAM fitted to C3VD's colonoscope, for images of any size.

    Args:
        image: One of the images.
        is_undistorted: Whether the images are undistorted.
    """
    height, width = image_size(image)
    across, down = width / _FIT_SIZE[0], height / _FIT_SIZE[1]
    fx, fy, cx, cy, k1, k2 = _FIT
    lens = LensPinhole(
        fx=fx * across,
        fy=fy * down,
        cx=(cx + 0.5) * across - 0.5,
        cy=(cy + 0.5) * down - 0.5,
        k1=0.0 if is_undistorted else k1,
        k2=0.0 if is_undistorted else k2,
    )
    return Camera("camera", lens, width, height)


def write_endogslam(folder: Path, lens: LensPinhole, camera: Camera, step: float) -> None:
    """Write the camera in EndoGSLAM's data set configuration; `step` [m] is the depth step."""
    scale = MM / step
    text = f"""dataset_name: c3vd
camera_params:
  image_height: {camera.height}
  image_width: {camera.width}
  fx: {lens.fx!r}
  fy: {lens.fy!r}
  cx: {lens.cx!r}
  cy: {lens.cy!r}
  png_depth_scale: {scale!r}
"""
    write_bytes(folder / ENDOGSLAM, text.encode())


def read_endogslam(folder: Path, top: Path) -> Camera | None:
    """Camera of the nearest `c3vd.yaml`; None if there is none.

    Raises:
        InputError: If it cannot be read.
    """
    path = nearest_file(folder, top, ENDOGSLAM)
    if path is None:
        return None
    plain = read_yaml(path).get("camera_params")
    keys = ("fx", "fy", "cx", "cy", "image_width", "image_height")
    found = {"camera_params": [plain.get(key) for key in keys] if isinstance(plain, dict) else None}
    fx, fy, cx, cy, width, height = numbers_of(found, "camera_params", len(keys), path)
    return Camera("camera", LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy), int(width), int(height))


def write_ppsnet(folder: Path, lens: LensPinhole) -> None:
    """Write `camera.txt`, one line of six words."""
    numbers = " ".join(f"{value!r}" for value in (lens.fx, lens.fy, lens.cx, lens.cy))
    write_bytes(folder / PPSNET, f"pinhole {numbers} 0\n".encode())


def read_ppsnet(folder: Path, image: Path) -> Camera:
    """Camera of `camera.txt`.

    Raises:
        InputError: If it cannot be read.
    """
    path = folder / PPSNET
    try:
        _, *words, _ = path.read_text("utf-8-sig").splitlines()[0].split()
        fx, fy, cx, cy = (float(word) for word in words)
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"Cannot read {path}: {error}. It holds six words.") from error
    height, width = image_size(image)
    return Camera("camera", LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy), width, height)
