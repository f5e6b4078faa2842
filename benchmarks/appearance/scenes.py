"""Views of lesions, and their exposure, for the gallery."""

from __future__ import annotations

import numpy as np

import vrcaps
from docs.images.lesions import best_view, even_exposure
from vrcaps import _core
from vrcaps.capsule.device import Device
from vrcaps.core.geometry import invert, look_along, transform_from
from vrcaps.lesion import add_lesions, parse_lesion
from vrcaps.world.model import Model, State

SETTINGS = vrcaps.RenderSettings(supersampling=2, shadows=True, light="radiosity")

Scene = tuple[Model, list[State]]
"""A world and the places to look from."""


def at_lesions(
    name: str, seed: int, texts: tuple[str, ...], device: Device, rng: np.random.Generator
) -> Scene:
    """Each lesion of a patient from where it is seen best."""
    lesions = [parse_lesion(text) for text in texts]
    organ = add_lesions(vrcaps.generate_organ(name, seed=seed), lesions, rng).organ
    model, camera = Model(organ, device), device.cameras[0]
    wall = Model(organ, device, np.eye(4)).wall
    states = []
    for record in organ.metadata["lesions"]:
        eye, target = best_view(organ, wall, record["instance"], camera)
        pose = transform_from(look_along(target - eye, rng.normal(size=3)), eye)
        # The camera, not the capsule's middle, is where the lesion is seen from.
        states.append(State(0.0, model.T_world_patient @ pose @ invert(camera.T_capsule_camera)))
    return model, states


def exposed(radiance: np.ndarray, mean_luminance: float) -> np.ndarray:
    """SRGB with the exposure that an automatic control would choose, see `even_exposure`."""
    exposure = even_exposure(radiance, mean_luminance)
    return _core.encode_srgb(np.ascontiguousarray(radiance, np.float32), exposure)
