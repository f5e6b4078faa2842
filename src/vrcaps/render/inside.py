"""Views from inside an organ, along its centreline, by the lamps and lens of a capsule."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.capsule.catalog import load_device
from vrcaps.organ.centerline import interpolate
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.transforms import invert, transform_from
from vrcaps.world.model import Model, State

if TYPE_CHECKING:
    from jaxtyping import UInt8

_BRIGHT = 0.6  # linear value that the 90th percentile of an image is brought to
_GAIN = (0.25, 12.0)  # of the capsule's own exposure; capsules regulate theirs likewise


def inside_views(
    organ: OrganSurface, arc_length: Sequence[float], *, capsule: str = "mirocam"
) -> list[UInt8[np.ndarray, "h w 3"]]:
    """What a capsule on the centreline sees that looks towards the anal end.

    Args:
        organ: The organ.
        arc_length: Where [m].
        capsule: Whose front camera; its exposure is regulated in each view.
    """
    device = load_device(capsule)
    camera = device.cameras[0]
    renderer = Renderer(
        Model(organ, device, np.eye(4)), RenderSettings(supersampling=2, shadows=True)
    )
    points, frames, _ = interpolate(organ.centerline, np.asarray(arc_length, float))
    T_camera_capsule = invert(camera.T_capsule_camera)
    images = []
    for point, frame in zip(points, frames, strict=True):
        state = State(0.0, transform_from(frame, point) @ T_camera_capsule)
        radiance = renderer.render(state, camera, channels=("radiance",)).radiance
        assert radiance is not None
        lit = np.append(radiance[..., 0][radiance[..., 0] > 0.0], 1e-9)
        gain = _BRIGHT / (np.percentile(lit, 90) * camera.exposure)
        images.append(_core.encode_srgb(radiance, camera.exposure * float(np.clip(gain, *_GAIN))))
    return images
