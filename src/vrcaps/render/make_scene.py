"""Scene of the compiled core: its representation of an organ for rendering."""

from __future__ import annotations

import numpy as np

from vrcaps import _core
from vrcaps.organ.surface import Appearance, OrganSurface, clearcoat_alpha, face_label
from vrcaps.render.imaging import Imaging
from vrcaps.render.mucus_film import apply_mucus_film
from vrcaps.render.scattering import optical_properties
from vrcaps.render.settings import RenderSettings

_PLAIN_ALBEDO = (0.52, 0.22, 0.16)
_PLAIN_ROUGHNESS = 0.5
_PLAIN = Appearance(np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.uint8), np.zeros((1, 1)))


def make_scene(organ: OrganSurface, settings: RenderSettings, imaging: Imaging) -> _core.Scene:
    """Scene of the core for an organ.

    Args:
        organ: Organ to render; drawn plain if it has no appearance.
        settings: Mucus film and scattering.
        imaging: Colors of the LEDs and the camera.
    """
    if settings.mucus_film_um is not None:
        organ = apply_mucus_film(organ, 1e-6 * settings.mucus_film_um)
    look, texture = imaging.appearance(organ.appearance or _PLAIN), None
    albedo = imaging.reflectance(np.array(_PLAIN_ALBEDO))
    if organ.appearance is not None:
        height = np.ascontiguousarray(look.height, np.float32)
        texture = _core.Texture(look.albedo, look.roughness, height)
    return _core.Scene(
        np.ascontiguousarray(organ.uv, np.float32),
        face_label(organ.label, organ.faces),
        face_label(organ.instance, organ.faces),
        organ.arc_length.astype(np.float32),
        texture=texture,
        albedo=tuple(albedo),
        roughness=_PLAIN_ROUGHNESS,
        reflectance=(look.ior, look.clearcoat, clearcoat_alpha(look.clearcoat_gloss)),
        tissue=optical_properties(imaging.bands_nm) if settings.scattering else None,
    )
