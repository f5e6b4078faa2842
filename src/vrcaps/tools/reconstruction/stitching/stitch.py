"""Reconstruction by stitching: algorithm 1 of Incetan et al., VR-Caps (2021), step by step.

1. Highlights are detected by Otsu's threshold and inpainted (`matching`).
2. SIFT features are matched between images; RANSAC fits homographies (`matching`).
3. Bundle adjustment makes all pairs consistent (`mosaic`).
4. The images are blended into one by multi-band blending (`mosaic`).
5. The depth of that image gives a surface (`surface`). Depth is estimated by a network as in the
   paper, by shading, or taken from the images' own depth.
6. ICP registers the surface to the true wall (`surface`); errors are drawn on it (`compare`).

The paper's listing inpaints the stitched image, its text inpaints first. This implementation
inpaints first, since highlights move with the light. Fisheye images are rectified beforehand, as
homographies require.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.camera import Camera, in_image, pixel_grid, project_points
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.formats.rectify import rectified, widest_field
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.reconstruction.matching import (
    Pair,
    connected,
    image_pairs,
    sift_features,
    without_highlights,
)
from vrcaps.tools.reconstruction.stitching.mosaic import (
    Mosaic,
    adjusted,
    blended,
    chained_homographies,
    usable,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Int

_RIM_PX = 4
"""Width of the excluded rim of a lens's field: its edge does not move, and would match."""


@dataclass(frozen=True)
class StitchSettings:
    """Settings of the stitching.

    Attributes:
        field_of_view: Field of view of the rectified images [rad]; less if the lens has less.
        every: Stride between the frames used.
        num_features: Maximum number of SIFT features of an image.
        tolerance: Maximum distance of an inlier from its mapped position [px].
    """

    field_of_view: Annotated[float, Range(above=0.0, below=pi)] = radians(90.0)
    every: Annotated[int, Range(1)] = 1
    num_features: Annotated[int, Range(20)] = 800
    tolerance: Annotated[float, Range(above=0.0)] = 3.0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Stitched:
    """Result of stitching.

    Attributes:
        mosaic: The wide image.
        sequence: The frames used, rectified.
        frames: Their indices in the source.
        pairs: Overlapping frames, by their indices in `sequence`.
    """

    mosaic: Mosaic
    sequence: FrameSequence
    frames: Int[np.ndarray, " n"]
    pairs: tuple[Pair, ...]


def stitch(
    sequence: FrameSequence,
    settings: StitchSettings,
    *,
    progress: ProgressReport = no_report,
) -> Stitched:
    """Stitch the frames of a sequence into one wide image, with depth if it is known.

    Args:
        sequence: Images and camera; depth, if the wide image needs depth.
        settings: Settings of the stitching.
        progress: Called with the number of frames with computed features and the total.

    Raises:
        InputError: If there is no camera, or no two frames overlap.
        MissingExtraError: If OpenCV is not installed.
    """
    chosen = np.arange(0, len(sequence), settings.every)
    frames = _rectified(sequence, chosen, settings.field_of_view)
    camera = _camera_of(frames)
    is_seen = _seen(_camera_of(sequence), camera)
    images, features = [], []
    for index in range(len(frames)):
        images.append(without_highlights(frames.image("rgb", index)))
        features.append(sift_features(images[-1], settings.num_features, is_seen))
        progress(index + 1, len(frames))
    pairs = image_pairs(features, settings.tolerance)
    component = connected(len(images), pairs)
    if not component:
        most = max((len(one.points) for one in features), default=0)
        raise InputError(
            f"No two of {len(images)} frames of {sequence.name} can be stitched: too few features "
            f"match (at most {most} per frame). Give frames that overlap more (--every), or "
            "--method fusion."
        )
    size = (camera.width, camera.height)
    reference, homographies = chained_homographies(len(images), component, pairs)
    homographies = usable(adjusted(homographies, pairs, reference, size), camera)
    depth = (lambda k: frames.image("depth", k)) if "depth" in frames.channels else None
    mosaic = blended(homographies, camera, images.__getitem__, depth, reference, is_seen)
    return Stitched(mosaic, frames, chosen, tuple(pairs))


def _rectified(
    sequence: FrameSequence, chosen: Int[np.ndarray, " n"], field_of_view: float
) -> FrameSequence:
    """Rectify images and depth of selected frames to a pinhole camera."""
    if sequence.camera is None:
        raise InputError(f"{sequence.name} has no calibrated camera, which stitching requires.")
    channels = [name for name in ("rgb", "depth") if name in sequence.channels]
    used = sequence.with_channels(channels).subset(chosen)
    return rectified(used, min(field_of_view, widest_field(sequence.camera)))


def _seen(lens_camera: Camera, pinhole: Camera) -> Bool[np.ndarray, "h w"]:
    """Mask of the rectified pixels that lie well within the field of the lens."""
    from scipy.ndimage import binary_erosion

    pixels = project_points(
        lens_camera, pinhole.lens.unproject(pixel_grid(pinhole.width, pinhole.height))
    )
    return binary_erosion(in_image(lens_camera, pixels), iterations=_RIM_PX, border_value=1)


def _camera_of(sequence: FrameSequence) -> Camera:
    assert sequence.camera is not None, "frames without a camera are refused"
    return sequence.camera
