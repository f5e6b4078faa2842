"""Batched rendering: many walls or poses in one call of the compiled core."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.render.renderer import Renderer

BATCH_CHANNELS = tuple(
    name for name, kind in CHANNELS.items() if kind.stage == "core" and kind.if_empty is None
)
"""Channels that depend on one image only: not on motion, lumen contents or the dome."""


def renders_batches(renderer: Renderer) -> bool:
    """Check whether a renderer supports batches: direct light and an empty lumen."""
    settings = renderer.settings
    is_direct = settings.light == "direct" and not settings.is_supersampled
    is_clear = renderer.model.contents.medium_and_film == (None, None)
    return is_direct and is_clear and renderer.model.lumen_contents is None


def render_batch(
    renderers: Sequence[Renderer],
    Ts_wall_camera: Float[np.ndarray, "n 4 4"],
    camera: Camera,
    channels: Sequence[str] = ("rgb", "depth"),
    *,
    walls: Sequence[_core.Wall] | None = None,
    out: Mapping[str, NDArray[Any]] | None = None,
) -> dict[str, NDArray[Any]]:
    """Render images from several poses, each with the same bytes as `Renderer.render`.

    All threads share the work. Renderers hold the textures: use one renderer for all worlds with
    the same organ.

    Example:
        >>> renderer = Renderer(model, RenderSettings(light="direct"))
        >>> Ts_world_camera = Ts_world_capsule @ camera.T_capsule_camera
        >>> images = render_batch([renderer], Ts_world_camera, camera)["rgb"]

    Args:
        renderers: One for all images or one per image; their settings must be equal, their
            organs may differ; see `renders_batches`.
        Ts_wall_camera: Poses of the camera in the frame of the walls.
        camera: Camera, at the size of the images.
        channels: Some of `BATCH_CHANNELS`.
        walls: One for all images or one per image, such as those of `World`, which are in the
            patient frame and may have moved; None: the wall of each renderer's model, at rest
            in the world frame.
        out: C-contiguous arrays of earlier images [n h w …] to overwrite, by channel.

    Returns:
        Arrays [n h w …] by channel.

    Raises:
        UnknownNameError: If a channel does not exist.
        InputError: If a renderer's light is not direct, it has contents, settings differ,
            counts or shapes do not match, or a pose is not finite.
    """
    poses = np.ascontiguousarray(Ts_wall_camera, np.float64)
    _check(renderers, channels, poses)
    arrays = {name: _array(name, len(poses), camera, out or {}) for name in channels}
    first = renderers[0]
    try:
        _core.render_batch(
            [renderer.model.wall for renderer in renderers] if walls is None else walls,
            [renderer._scene for renderer in renderers],
            first._table(camera, 1),
            poses,
            first._leds(camera),
            arrays,
            exposure=camera.exposure,
            shadows=first.settings.shadows,
        )
    except ValueError as error:
        raise InputError(str(error)) from error
    return arrays


def _check(renderers: Sequence[Renderer], channels: Sequence[str], poses: np.ndarray) -> None:
    for name in channels:
        if name not in BATCH_CHANNELS:
            raise UnknownNameError("channel of a batch", name, BATCH_CHANNELS)
    if poses.ndim != 3:
        raise InputError(f"Poses have the shape {poses.shape}. Allowed: (n, 4, 4).")
    if not renderers:
        raise InputError("renderers is empty. Allowed: one for all images or one per image.")
    distinct = {id(renderer): renderer for renderer in renderers}.values()
    for renderer in distinct:
        if not renders_batches(renderer):
            raise InputError(
                f"Batches require direct light in an empty lumen, but light is "
                f"{renderer.settings.light!r}. Set light to 'direct' and supersampling to 1 and "
                "omit the contents, or render one by one."
            )
        if renderer.settings != renderers[0].settings:
            raise InputError(
                "Renderers of a batch have different settings. Allowed: equal settings."
            )


def _array(name: str, count: int, camera: Camera, out: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """Return the array to render a channel into: a given one that fits, or a new one."""
    kind = CHANNELS[name]
    shape = (count, *kind.shape(camera.height, camera.width))
    given = out.get(name)
    if given is None:
        return np.empty(shape, kind.dtype)
    if given.shape != shape or given.dtype != kind.dtype or not given.flags.c_contiguous:
        raise InputError(
            f"Array of {name} is {given.dtype} {given.shape}. Allowed: {np.dtype(kind.dtype)} "
            f"{shape}, C-contiguous."
        )
    return given
