"""Reconstruction by stitching: algorithm 1 of Incetan et al., VR-Caps (2021), step by step.

1. Highlights are found by Otsu's threshold and inpainted (`highlights`).
2. SIFT features are matched between images; RANSAC finds homographies (`matching`).
3. Bundle adjustment makes all pairs agree (`bundle`).
4. The images are blended in bands into one (`mosaic`).
5. Depth of that one image makes a surface (`stitch_surface`): estimated by a network as in the
   paper, by shading, or taken over from the images' own depth.
6. ICP registers the surface to the true wall (`icp`); errors are drawn on it (`compare`).

The paper's listing inpaints the stitched image, its text inpaints first; so do we, since highlights
move with the light. Images of fisheye lenses are rectified first, for which homographies hold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, radians
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.camera import Camera, in_image, pixel_grid, project_points
from vrcaps.errors import InputError
from vrcaps.formats.rectify import rectified, widest_field
from vrcaps.limits import Range, check_fields
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.reconstruction.bundle import adjusted, chained_homographies
from vrcaps.tools.reconstruction.highlights import without_highlights
from vrcaps.tools.reconstruction.matching import Pair, image_pairs, sift_features
from vrcaps.tools.reconstruction.mosaic import Mosaic, blended, usable
from vrcaps.tools.reconstruction.pair_graph import connected

if TYPE_CHECKING:
    from jaxtyping import Bool, Int


_RIM_PX = 4
"""Width of the rim of a lens's field that is left out: its edge stays in place and would match."""


@dataclass(frozen=True)
class StitchSettings:
    """How images are stitched.

    Attributes:
        field_of_view: Of the images that are stitched [rad]; less if the lens sees less.
        every: Every how many frames is used.
        num_features: Most SIFT features of an image.
        tolerance: Distance from where a homography puts it within which a match fits [px].
    """

    field_of_view: Annotated[float, Range(above=0.0, below=pi)] = radians(90.0)
    every: Annotated[int, Range(1)] = 1
    num_features: Annotated[int, Range(20)] = 800
    tolerance: Annotated[float, Range(above=0.0)] = 3.0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Stitched:
    """What stitching found.

    Attributes:
        mosaic: The wide image.
        sequence: The frames that were used, rectified.
        frames: Their numbers in the source.
        pairs: Frames that show the same place, by their numbers in `sequence`.
    """

    mosaic: Mosaic
    sequence: FrameSequence
    frames: Int[np.ndarray, " n"]
    pairs: tuple[Pair, ...]


def stitch(
    sequence: FrameSequence,
    settings: StitchSettings,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Stitched:
    """One wide image of a sequence's frames, with their depth if it is known.

    Args:
        sequence: Images and camera; depth, if the wide image is to have some.
        settings: How they are stitched.
        progress: Called with the number of frames whose features are known and of all.

    Raises:
        InputError: If there is no camera, or no two frames show the same place.
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
            f"match (at most {most} a frame). Give frames that overlap more (--every), or --method "
            "fusion."
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
    """Images and depth of chosen frames as a pinhole sees them."""
    if sequence.camera is None:
        raise InputError(f"Stitching needs a calibrated camera, which {sequence.name} has not.")
    channels = [name for name in ("rgb", "depth") if name in sequence.channels]
    used = sequence.with_channels(channels).subset(chosen)
    return rectified(used, min(field_of_view, widest_field(sequence.camera)))


def _seen(lens_camera: Camera, pinhole: Camera) -> Bool[np.ndarray, "h w"]:
    """Pixels of the rectified images that lie well within the field of the lens."""
    from scipy.ndimage import binary_erosion

    pixels = project_points(
        lens_camera, pinhole.lens.unproject(pixel_grid(pinhole.width, pinhole.height))
    )
    return binary_erosion(in_image(lens_camera, pixels), iterations=_RIM_PX, border_value=1)


def _camera_of(sequence: FrameSequence) -> Camera:
    assert sequence.camera is not None, "frames without a camera are refused"
    return sequence.camera
