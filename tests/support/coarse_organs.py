"""Coarse organs in the place of the catalog's, for tests of programs that take any organ.

A cache folder contains them under the names of organs of the catalog, so a program that generates
one only reads it. Textures that a program bakes itself, and images of capsules of the catalog, are
coarse by `COARSE`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from tests.support.tubes import straight_gut
from vrcaps.camera.derive import scaled_camera
from vrcaps.capsule import device_file
from vrcaps.core.files import cache_in
from vrcaps.organ.surface import OrganSurface

TEXELS_PER_MM, ATLAS = 1.0, 512
"""Texels of a texture, and width of the atlas in which its charts are packed [texels]."""
IMAGE_SCALE = 0.5
"""Width of images relative to the catalog's."""
COARSE = f"""
import vrcaps.capsule.device_file, vrcaps.mucosa.bake, vrcaps.organ.uv
from tests.support.coarse_organs import read_small_device
vrcaps.capsule.device_file._parsed = {{}}
vrcaps.capsule.device_file.read_device_file = read_small_device
vrcaps.mucosa.bake.DEFAULT_TEXELS_PER_MM = {TEXELS_PER_MM}
vrcaps.organ.uv._RESOLUTION = {ATLAS}
"""
"""Statements for the beginning of a program."""

_PLAN = (101_010_639, 125_018_573, 458_834_840)  # first patients of a plan of seed 0
_NAMES = {
    "colon": ((0, None), (0, "normal"), (1, None), (3, None)),
    "stomach": ((0, "inflated"), *((seed, None) for seed in (0, 1, 2, 3, 100, *_PLAN))),
    "small-bowel": ((0, None), (0, "collapsed")),
}
"""Seeds and distensions of the organs of pages, notebooks and examples."""


@pytest.fixture(scope="module", autouse=True)
def coarse_looks() -> Iterator[None]:
    """Textures and images are coarse in the modules of a folder whose conftest imports this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vrcaps.organ.uv._RESOLUTION", ATLAS)
        patch_looks(patch)
        yield


def patch_looks(patch: pytest.MonkeyPatch) -> None:
    """Make textures and images of capsules of the catalog coarse."""
    patch.setattr("vrcaps.mucosa.bake.DEFAULT_TEXELS_PER_MM", TEXELS_PER_MM)
    patch.setattr(device_file, "_parsed", {})
    patch.setattr(device_file, "read_device_file", read_small_device)


_read_device_file = device_file.read_device_file


def read_small_device(path: Path) -> device_file.Device:
    """Read a device from its TOML file; images of one of the catalog are smaller."""
    device = _read_device_file(path)
    if path.parent != device_file._DEVICES.path:
        return device
    cameras = tuple(scaled_camera(camera, IMAGE_SCALE) for camera in device.cameras)
    return replace(device, cameras=cameras)


def fill_cache(folder: Path) -> None:
    """Write coarse organs into a cache folder; those that another process has written stay."""
    from vrcaps.anatomy import catalog

    with cache_in(folder), pytest.MonkeyPatch.context() as patch:
        for name, patients in _NAMES.items():
            catalog._generator(name)  # its module registers it
            patch.setitem(catalog._GENERATORS, name, lambda _, name=name: coarse_organ(name))
            for seed, distension in patients:
                catalog.generate_organ(name, seed=seed, distension=distension)


@cache
def coarse_organ(name: str) -> OrganSurface:
    """Organ of patient 0 with few triangles and texels; the small bowel is a straight tube."""
    from vrcaps.anatomy.colon import generate_colon
    from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy
    from vrcaps.anatomy.stomach import generate_stomach
    from vrcaps.mucosa.bake import bake_appearance
    from vrcaps.organ.segments import ORGANS

    patient = draw_patient_anatomy(0)
    if name == "colon":
        organ = generate_colon(replace(patient.colon, triangles=20_000), seed=0)
    elif name == "stomach":
        organ = generate_stomach(replace(patient.stomach, edge=4e-3), seed=0)
    else:
        organ = straight_gut({"duodenum": 0.2, "jejunum": 0.4, "ileum": 0.4}, edge=4e-3, name=name)
    mucosa = ORGANS[name].mucosa
    look = bake_appearance(organ, seed=0, mucosa=mucosa, texels_per_mm=TEXELS_PER_MM)
    return replace(organ, appearance=look)
